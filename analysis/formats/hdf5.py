"""What stands between a damaged HDF5 file and the HDF5 library, which some damages make search for ever.

A file of gonio's own ends in a seal, a line with the SHA-256 of all that stands before it; other programs
do not read past HDF5's own end, and drop the seal when they change the file. Where it fits, every bit of
the content is as it was written. A file without it, of another program or an older gonio, is read first by a
process of its own (`python -m analysis.formats.hdf5 FILE`) that may die or be ended without harm.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

from rig.errors import BadInput

PREFIX = b"\ngonio sha256 "
SEAL_BYTES = len(PREFIX) + 64 + 1
CHUNK_BYTES = 1 << 20

SEARCH_S = 1.5
BYTES_PER_S = 20e6
"""Time to read it, once the process stands: a fixed part, and a part by the file's size."""

MOST_COMPRESSION = 1100
"""Deflate makes at most 1032 bytes of one; what declares more than that times its size is no data."""

READY = "ready"
_FAULTS = (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, LookupError, MemoryError)


def sealed(content: bytes) -> bytes:
    """Return an HDF5 file's content with its seal."""
    return content + PREFIX + hashlib.sha256(content).hexdigest().encode() + b"\n"


def require_harmless(path: Path) -> None:
    """Return if the HDF5 library can be trusted with a file.

    Raises
    ------
    BadInput
        If the seal does not fit the content, or a process that read the file failed or did not end.
    """
    if not _seal_holds(path):
        _try_elsewhere(path)


def _seal_holds(path: Path) -> bool:
    """Whether the file ends in a seal that fits."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        stream.seek(max(size - SEAL_BYTES, 0))
        seal = stream.read()
        if not (seal.startswith(PREFIX) and seal.endswith(b"\n")):
            return False
        stream.seek(0)
        digest, left = hashlib.sha256(), size - SEAL_BYTES
        while left > 0:
            block = stream.read(min(left, CHUNK_BYTES))
            if not block:
                break
            digest.update(block)
            left -= len(block)
    if digest.hexdigest().encode() != seal[len(PREFIX) : -1]:
        raise BadInput(
            "is not what was written: its checksum does not fit",
            where=f"{path}: byte {size - SEAL_BYTES}",
            todo="it was damaged on its way: copy it again",
        )
    return True


def _try_elsewhere(path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "analysis.formats.hdf5", str(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None  # noqa: S101 - it is a pipe
        try:
            started = process.stdout.readline().strip() == READY
            answer, _ = process.communicate(timeout=SEARCH_S + path.stat().st_size / BYTES_PER_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise _damaged(path, "the library searches in it without end") from None
    if started and process.returncode:
        raise _damaged(path, answer.strip() or "the library fails on it")


def _damaged(path: Path, reason: str) -> BadInput:
    return BadInput(f"is not a whole NetCDF file ({reason})", where=str(path), todo="copy or reduce it again")


def read_all(path: Path) -> None:
    """Read every variable and attribute that a reader of samples could ask for.

    Raises
    ------
    ValueError
        If the file declares more than it can hold.
    """
    import h5netcdf

    largest = path.stat().st_size * MOST_COMPRESSION
    with h5netcdf.File(path, "r", phony_dims="access") as file:
        _read_attributes(file)
        for variable in file.variables.values():
            _read_attributes(variable)
            count = 1
            for length in variable.shape:
                count *= int(length)
            if count * variable.dtype.itemsize > largest:
                raise ValueError(f"{variable.name} declares {count} values, more than it can hold")
            _ = variable.dimensions, variable[...]


def _read_attributes(owner: Any) -> None:
    for name in owner.attrs:
        _ = owner.attrs[name]


def main(arguments: list[str]) -> int:
    """Read a file and say why it cannot be read; `_try_elsewhere` runs this."""
    import h5netcdf  # noqa: F401 - before the clock starts

    sys.stdout.write(f"{READY}\n")
    sys.stdout.flush()
    try:
        read_all(Path(arguments[0]))
    except _FAULTS as error:
        lines = str(error).splitlines()
        sys.stdout.write(lines[0] if lines else type(error).__name__)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
