"""Which of Mitsuba's variants can run here: found out by asking LLVM for its version, never by crashing.

Dr.Jit 1.5 emits instructions that LLVM 15 and 16 cannot compile: the process is then killed, without an
exception that could be caught. Left alone it takes whatever library it finds, so the choice is made here,
before Mitsuba loads, and handed to Dr.Jit in `DRJIT_LIBLLVM_PATH`.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.errors import BadInput

SCALAR = "scalar_rgb"
LLVM = "llvm_ad_rgb"
OLDEST_LLVM = 19
"""Oldest major version that compiles every kernel of Dr.Jit 1.5 (15 and 16 abort; 17 and 18 are not
tested)."""

VARIANT_VARIABLE = "GONIO_VARIANT"
LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"

_SHORT_NAMES = {"scalar": SCALAR, "llvm": LLVM, SCALAR: SCALAR, LLVM: LLVM}
_PATTERNS = ("libLLVM*.so*", "libLLVM*.dylib")
_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/usr/lib/llvm-*/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)

Version = tuple[int, int, int]
Probe = Callable[[Path], Version | None]


@dataclass(frozen=True)
class Choice:
    """The variant to use, and why.

    Attributes
    ----------
    variant : str
        "llvm_ad_rgb" or "scalar_rgb".
    library : Path or None
        The LLVM library that Dr.Jit is to load; None in scalar mode.
    advice : str
        One line on how to be faster; empty where nothing is to be said.
    """

    variant: str
    library: Path | None = None
    advice: str = ""


def llvm_version(library: Path) -> Version | None:
    """Ask an LLVM library for its version.

    Parameters
    ----------
    library : Path
        A shared library.

    Returns
    -------
    tuple of int or None
        Major, minor, patch; None where it does not load or is older than LLVM 16, which cannot tell.
    """
    try:
        ask = ctypes.CDLL(str(library)).LLVMGetVersion
    except (OSError, AttributeError):
        return None
    parts = [ctypes.c_uint() for _ in range(3)]
    ask(*(ctypes.byref(part) for part in parts))
    major, minor, patch = (part.value for part in parts)
    return major, minor, patch


def installed_libraries(folders: Iterable[str] = _FOLDERS) -> list[Path]:
    """LLVM libraries of this machine, newest first by the number in their name, each file once.

    Names without a number come first: only the library itself knows what it is.

    Parameters
    ----------
    folders : iterable of str
        Glob patterns of absolute folders.

    Returns
    -------
    list of Path
    """
    found: set[Path] = set()
    for pattern in folders:
        for folder in Path("/").glob(pattern.lstrip("/")):
            for name in _PATTERNS:
                found |= {path.resolve() for path in folder.glob(name)}
    return sorted(found, key=lambda path: (-_major_of_name(path), path))


def _major_of_name(path: Path) -> int:
    number = re.search(r"libLLVM[-.A-Za-z]*?(\d+)", path.name)
    return int(number.group(1)) if number else 10**6


def choose_variant(
    asked: str | None = None,
    *,
    environ: Mapping[str, str] | None = None,
    libraries: Callable[[], list[Path]] = installed_libraries,
    probe: Probe = llvm_version,
) -> Choice:
    """Choose the fastest variant that cannot kill the process.

    Parameters
    ----------
    asked : str, optional
        "llvm", "scalar" or a variant's full name; before the environment's `GONIO_VARIANT`.
    environ : mapping, optional
        The environment; by default this process's. Its `DRJIT_LIBLLVM_PATH`, where set, is the only library
        considered, because Dr.Jit would take it.
    libraries, probe : callable
        Where libraries are found and how one tells its version.

    Returns
    -------
    Choice

    Raises
    ------
    BadInput
        A variant is asked for that does not exist.
    """
    environ = os.environ if environ is None else environ
    wanted = asked or environ.get(VARIANT_VARIABLE) or LLVM
    if wanted not in _SHORT_NAMES:
        where = "variant" if asked else VARIANT_VARIABLE
        raise BadInput(f"there is no variant {wanted!r}", where=where, todo="use llvm or scalar")
    if _SHORT_NAMES[wanted] == SCALAR:
        return Choice(SCALAR)
    given = environ.get(LIBRARY_VARIABLE)
    candidates = [Path(given)] if given else libraries()
    for library in candidates:
        # A name that states an old number need not be loaded to be turned down.
        if not given and _major_of_name(library) < OLDEST_LLVM:
            continue
        version = probe(library)
        if version is not None and version[0] >= OLDEST_LLVM:
            return Choice(LLVM, library)
    return Choice(SCALAR, advice=_advice(given, candidates))


def _advice(given: str | None, candidates: list[Path]) -> str:
    if given:
        problem, cure = f"{LIBRARY_VARIABLE}={given} is not LLVM >= {OLDEST_LLVM}", "point it at a newer one"
    elif sys.platform == "darwin":
        problem, cure = f"no LLVM >= {OLDEST_LLVM} found", "for faster light: brew install llvm"
    else:
        newest = f" ({candidates[0].name} cannot be used)" if candidates else ""
        problem = f"no LLVM >= {OLDEST_LLVM} found{newest}"
        cure = f"for faster light: apt install libllvm{OLDEST_LLVM}"
    return f"rendering with {SCALAR}: {problem}; {cure}"


def load_mitsuba(asked: str | None = None, *, say: Callable[[str], object] | None = None) -> Any:
    """Import Mitsuba with the variant of `choose_variant` set.

    Parameters
    ----------
    asked : str, optional
        As in `choose_variant`.
    say : callable, optional
        Receives the one line of advice, where there is one; by default it goes to standard error.

    Returns
    -------
    module
        `mitsuba`; its `variant()` names the choice.

    Raises
    ------
    BadInput
        As in `choose_variant`.
    """
    choice = choose_variant(asked)
    if choice.library is not None:
        os.environ[LIBRARY_VARIABLE] = str(choice.library)
    with _without_lines_of(b"jit"):
        import mitsuba

    try:
        mitsuba.set_variant(choice.variant)
    except ImportError as error:
        # The library told its version and yet Dr.Jit cannot use it, for one of its own reasons.
        reason = str(error).splitlines()[0]
        choice = Choice(SCALAR, advice=f"rendering with {SCALAR}: {reason}; install LLVM {OLDEST_LLVM}")
        mitsuba.set_variant(SCALAR)
    if choice.advice:
        (say or _say)(choice.advice)
    return mitsuba


@contextlib.contextmanager
def _without_lines_of(speaker: bytes) -> Iterator[None]:
    """Keep lines of Dr.Jit's own off standard error: that there is no LLVM is told once, with what to do."""
    try:
        stderr = os.dup(2)
    except OSError:  # a process without one
        yield
        return
    with tempfile.TemporaryFile() as written:
        sys.stderr.flush()
        os.dup2(written.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            written.seek(0)
            for line in written:
                if not line.startswith(speaker):
                    os.write(2, line)


@functools.cache  # once for each line is enough for a person
def _say(line: str) -> None:
    sys.stderr.write(line + "\n")
