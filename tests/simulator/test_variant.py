"""The variant is chosen from what LLVM says about itself, and no library can kill the process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rig.errors import BadInput
from simulator.variant import (
    LLVM,
    SCALAR,
    Choice,
    _without_lines_of,
    choose_variant,
    installed_libraries,
    llvm_version,
)

OLD, NEW = Path("libLLVM-15.so.1"), Path("libLLVM.so.19.1")
VERSIONS = {OLD: None, NEW: (19, 1, 7), Path("libLLVM.so"): (16, 0, 6), Path("mine.so"): (22, 1, 0)}


def choose(libraries: list[Path], environ: dict[str, str] | None = None, asked: str | None = None) -> Choice:
    """Choose between made-up libraries."""
    return choose_variant(asked, environ=environ or {}, libraries=lambda: libraries, probe=VERSIONS.get)


@pytest.mark.parametrize(
    ("libraries", "variant"),
    [([], SCALAR), ([OLD], SCALAR), ([NEW, OLD], LLVM), ([Path("libLLVM.so")], SCALAR)],
    ids=["none", "15 only", "19 beside 15", "unnumbered name of 16"],
)
def test_only_a_version_that_does_not_abort_is_used(libraries: list[Path], variant: str) -> None:
    """Would catch a choice by presence or by name instead of by version."""
    choice = choose(libraries)
    assert choice.variant == variant
    assert (choice.library is not None) == (variant == LLVM)
    assert bool(choice.advice) == (variant == SCALAR)


def test_an_old_library_is_not_even_loaded() -> None:
    """Would catch probing that maps a hundred megabytes of a library whose name already says no."""

    def probe(library: Path) -> None:
        pytest.fail(f"{library} was loaded")

    assert choose_variant(environ={}, libraries=lambda: [OLD], probe=probe).variant == SCALAR


def test_the_environments_library_is_the_only_candidate() -> None:
    """Would catch LLVM being promised where Dr.Jit would load the old library that the environment names."""
    assert choose([NEW], {"DRJIT_LIBLLVM_PATH": str(OLD)}).variant == SCALAR
    assert choose([OLD], {"DRJIT_LIBLLVM_PATH": "mine.so"}) == Choice(LLVM, Path("mine.so"))


def test_what_is_asked_for_wins_and_nonsense_is_refused() -> None:
    """Would catch an ignored override, and a typo that silently means something else."""
    assert choose([NEW], {"GONIO_VARIANT": "scalar"}) == Choice(SCALAR)
    assert choose([NEW], {"GONIO_VARIANT": "scalar_rgb"}, asked="llvm").variant == LLVM
    with pytest.raises(BadInput, match=r"GONIO_VARIANT.*'cuda'.*llvm or scalar"):
        choose([NEW], {"GONIO_VARIANT": "cuda"})


def test_advice_is_one_line_that_says_what_to_install() -> None:
    """Would catch advice that a person cannot act on."""
    advice = choose([OLD]).advice
    assert "\n" not in advice
    assert "libLLVM-15.so.1" in advice
    assert "libllvm19" in advice or "brew" in advice


def test_libraries_are_listed_newest_first_and_once(tmp_path: Path) -> None:
    """Would catch 9 sorted above 19, and one library probed twice through its links."""
    for name in ("libLLVM-9.so.1", "libLLVM.so.19.1", "libLLVM-15.so.1"):
        (tmp_path / name).touch()
    (tmp_path / "libLLVM-19.so").symlink_to(tmp_path / "libLLVM.so.19.1")
    names = [path.name for path in installed_libraries([str(tmp_path)])]
    assert names == ["libLLVM.so.19.1", "libLLVM-15.so.1", "libLLVM-9.so.1"]


def test_a_file_that_is_no_library_has_no_version(tmp_path: Path) -> None:
    """Would catch a damaged library ending the program."""
    damaged = tmp_path / "libLLVM.so.19.1"
    damaged.write_bytes(b"\x7fELF not really")
    assert llvm_version(damaged) is None


@pytest.mark.render
@pytest.mark.parametrize("variables", [{"GONIO_VARIANT": "scalar"}, {"DRJIT_LIBLLVM_PATH": "/no/libLLVM.so"}])
def test_a_process_without_llvm_renders_scalar(variables: dict[str, str]) -> None:
    """Would catch a process that dies, or stays silent about being slow, where there is no usable LLVM."""
    code = (
        "from simulator.variant import load_mitsuba; mi = load_mitsuba();"
        "print(mi.variant(), mi.load_dict({'type': 'diffuse'}).flags() is not None)"
    )
    environ = {key: value for key, value in os.environ.items() if key != "GONIO_VARIANT"} | variables
    result = subprocess.run(
        [sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=False, timeout=60
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == ["scalar_rgb", "True"]
    said = result.stderr.splitlines()
    # One line of ours, none of Dr.Jit's own; of what was asked for, nothing need be said.
    assert len(said) == ("GONIO_VARIANT" not in variables)
    assert all(line.startswith("rendering with scalar_rgb: ") for line in said)


@pytest.mark.render
@pytest.mark.parametrize(
    ("names", "version", "variant"),
    [
        (["libLLVM-15.so.1", "libLLVM.so.19.1"], None, SCALAR),
        (["libLLVM.so.19.1"], (16, 0, 6), SCALAR),
        ([], None, SCALAR),
        (["libLLVM-15.so.1", "libLLVM.so.19.1"], (19, 1, 7), LLVM),
    ],
    ids=["15 under the name of 19", "it tells another version", "none", "19 beside 15"],
)
def test_every_machine_gets_a_variant_and_at_most_a_line(
    tmp_path: Path, names: list[str], version: tuple[int, int, int] | None, variant: str
) -> None:
    """Would catch a library that is taken by its name, and two lines where one will do."""
    for name in names:
        (tmp_path / name).touch()
    choice = choose_variant(
        environ={},
        libraries=lambda: installed_libraries([str(tmp_path)]),
        probe=lambda path: version if "19" in path.name else pytest.fail(f"{path} was loaded"),
    )
    assert choice.variant == variant
    assert len(choice.advice.splitlines()) == (variant == SCALAR)


def test_dr_jit_waits_for_the_choice() -> None:
    """Would catch a module that imports Dr.Jit at its top, which takes any LLVM it finds, and aborts."""
    code = (
        "import sys, simulator.light.renderer, simulator.twin, gonio.commands.sim, gonio.commands.demo;"
        "sys.exit('drjit' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


def test_other_words_on_standard_error_are_kept(capfd: pytest.CaptureFixture[str]) -> None:
    """Would catch a warning that is swallowed with Dr.Jit's line."""
    with _without_lines_of(b"jit"):
        os.write(2, b"jitc_llvm_init(): failed\na warning\n")
    assert capfd.readouterr().err == "a warning\n"
