"""The formats that samples come in, told apart by content: a suffix is a wish, not a fact.

Each module offers `NAME`, `OPTIONS`, `sniff(head) -> bool` and `read(path, ...) -> Dataset`; some also
`SUFFIX` and `write(samples, path)`, which returns what the file loses of the samples. `OPEN_END` says that a
file of the format does not tell where it ends, so that what is cut short must be guessed (`doubts`). `sniff`
sees a text without its mark and with lines that end in LF.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from analysis.formats.text import BYTE_ORDER_MARK, UTF_16_MARKS, looks_like_text
from rig.errors import BadInput
from rig.files import whole_file

if TYPE_CHECKING:
    from pathlib import Path
    from types import ModuleType

    import xarray as xr

    from analysis.formats.loss import Loss

NAMES = (
    "netcdf",
    "rgl",
    "merl",
    "pab",
    "klems",
    "rt300s",
    "rt300s_text",
    "npz",
    "inplane",
    "csv",
    "fred",
    "zemax",
    "astm",
    "alta",
    "ssdd",
    "cornell",
)
HEAD_BYTES = 65536
LARGEST_BYTES = 4 * 1024**3
SESSION_FILE = "samples.nc"


def _modules() -> list[ModuleType]:
    return [importlib.import_module(f"analysis.formats.{name}") for name in NAMES]


def read(path: Path, options: dict[str, Any]) -> xr.Dataset:
    """Read a file of any known format; see `analysis.samples.read`.

    Raises
    ------
    BadInput
        If the file is missing, empty, too large, of no known format, damaged, or an option does not apply.
    """
    if path.is_dir():
        inside = path / SESSION_FILE
        if not inside.exists():
            raise BadInput(f"holds no {SESSION_FILE}", where=str(path), todo=f"run gonio reduce {path} first")
        path = inside
    module = recognise(path)
    given = {name: value for name, value in options.items() if value not in (None, False)}
    for name in given:
        if name not in module.OPTIONS:
            raise BadInput(
                f"{name.replace('_', ' ')} means nothing to {module.NAME}",
                where=str(path),
                todo="leave it out",
            )
    try:
        samples: xr.Dataset = module.read(path, **given)
    except MemoryError:
        raise BadInput(
            "needs more memory than there is", where=str(path), todo="split it, or store it as NetCDF"
        ) from None
    from analysis.formats.values import require_brdf

    require_brdf(samples, path)
    if getattr(module, "OPEN_END", False):
        from analysis.formats.doubts import ATTRIBUTE, doubts

        why = doubts(samples, path)
        return samples.assign_attrs({ATTRIBUTE: why}) if why else samples
    return samples


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write samples in the format that the name's end asks for; see `analysis.samples.write`.

    Returns
    -------
    Loss
        What the file loses of the samples: by interpolation onto its grid, and what it does not hold.

    Raises
    ------
    BadInput
        If no format is written under that suffix, or the file cannot be written there.
    Refused
        If the disk is full; an earlier file stays.
    """
    writer = require_writer(path)
    with whole_file(path) as file:
        loss: Loss = writer.write(samples, file)
    return loss


def require_writer(path: Path, to: str = "") -> ModuleType:
    """Give the format that writes a file of that name, before there is anything to write.

    Parameters
    ----------
    path : Path
        The file to be.
    to : str
        A format's short name, of `NAMES`; without it the name's end chooses.

    Raises
    ------
    BadInput
        If no format is written under that suffix or name, or there is no such folder.
    """
    if not path.absolute().parent.is_dir():
        raise BadInput("no such folder", where=str(path.parent), todo="make it, or choose another place")
    if to:
        named = {
            name: module for name, module in zip(NAMES, _modules(), strict=True) if hasattr(module, "SUFFIX")
        }
        if to not in named:
            raise BadInput(
                f"no format '{to}' is written", where=str(path), todo=f"choose from {', '.join(named)}"
            )
        return named[to]
    writers = {module.SUFFIX: module for module in _modules() if hasattr(module, "SUFFIX")}
    # The longest end counts: two formats share `.bsdf`, and one of them wants a word before it.
    suffix = max((end for end in writers if path.name.lower().endswith(end)), key=len, default="")
    if not suffix:
        raise BadInput(
            f"no format is written as '{path.suffix}'",
            where=str(path),
            todo=f"end the name in {', '.join(writers)}",
        )
    return writers[suffix]


def recognise(path: Path) -> ModuleType:
    """Tell a file's format by its content.

    Raises
    ------
    BadInput
        If the file is missing, empty, too large or of no known format.
    """
    if not path.is_file():
        raise BadInput("no such file", where=str(path), todo="check the path")
    size = path.stat().st_size
    if size == 0:
        raise BadInput("is empty", where=str(path), todo="copy it again from where it was made")
    if size > LARGEST_BYTES:
        raise BadInput(f"is {size / 1024**3:.1f} GB, more than gonio reads", where=str(path))
    with path.open("rb") as stream:
        head = clean_head(stream.read(HEAD_BYTES))
    modules = _modules()
    for module in modules:
        if module.sniff(head):
            return module
    whole = head.replace(b"\0", b"")
    if whole != head and any(module.sniff(whole) for module in modules):
        raise BadInput(
            "a zero byte stands in the text",
            where=f"{path}: byte {head.index(bytes(1))}",
            todo="it was damaged on its way, or is UTF-16 without its mark: copy or export it again",
        )
    known = ", ".join(str(module.NAME) for module in modules)
    raise BadInput("is of no format that gonio reads", where=str(path), todo=f"it reads {known}")


def clean_head(head: bytes) -> bytes:
    """Return the start of a text as formats sniff it: no mark, lines that end in LF; of others as it is."""
    if head.startswith(UTF_16_MARKS):
        head = head.decode("utf-16", errors="ignore").encode()
    if not looks_like_text(head):
        return head
    return head.removeprefix(BYTE_ORDER_MARK).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
