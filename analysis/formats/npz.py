"""Plain numpy archives of `wi`, `wo` and `f_r` (and `u_f_r`), as papers share them; never pickled."""

from __future__ import annotations

import tokenize
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.samples import make_samples
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

NAME = "NumPy .npz of wi, wo, f_r"
OPTIONS: tuple[str, ...] = ()
ARRAYS = ("wi", "wo", "f_r", "u_f_r")
MOST_BYTES = 4 * 1024**3
_DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    zipfile.BadZipFile,
    NotImplementedError,
    SyntaxError,
    tokenize.TokenError,  # numpy's, of a damaged header
)


def sniff(head: bytes) -> bool:
    """Whether the file is a zip archive, which `.npz` is."""
    return head.startswith(b"PK\x03\x04")


def read(path: Path) -> xr.Dataset:
    """Read samples; single precision directions are brought back to unit length.

    Raises
    ------
    BadInput
        If the archive is damaged, lacks an array, unpacks to more than gonio reads, or holds Python objects.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MOST_BYTES:
            raise BadInput(f"unpacks to {unpacked} bytes, more than gonio reads", where=str(path))
        with np.load(path, allow_pickle=False) as archive:
            arrays: dict[str, Any] = {
                name: np.asarray(archive[name], dtype=np.float64) for name in ARRAYS if name in archive.files
            }
    except _DAMAGE as error:
        raise BadInput(
            f"is not a whole .npz file ({error})", where=str(path), todo="copy it again"
        ) from error
    missing = [name for name in ("wi", "wo", "f_r") if name not in arrays]
    if missing:
        raise BadInput(f"has no array {missing[0]}", where=str(path), todo="store wi, wo and f_r")
    for name in ("wi", "wo"):
        length = np.linalg.norm(arrays[name], axis=-1, keepdims=True)
        # Single precision is unit to 1e-7 only; anything worse is left for make_samples to refuse.
        arrays[name] = np.where(
            np.abs(length - 1.0) < 1e-4, arrays[name] / np.maximum(length, 0.5), arrays[name]
        )
    wi, wo, f_r = arrays.pop("wi"), arrays.pop("wo"), arrays.pop("f_r")
    if not np.isfinite(f_r).all():
        row = int(np.argwhere(~np.isfinite(f_r))[0][0])
        raise BadInput(
            "is not a finite number", where=f"{path}: f_r of sample {row}", todo="remove the sample"
        )
    try:
        return make_samples(wi, wo, f_r, source=path.name, **arrays)
    except BadInput as error:
        raise BadInput(str(error), where=str(path)) from None
