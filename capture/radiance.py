"""A merge on disk, and as a small picture to look at."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.merge import Flag
from rig.errors import BadInput
from rig.files import whole_file

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.merge import Merged

_FILL = Flag.HOT | Flag.INCONSISTENT


def write_radiance(
    path: str | os.PathLike[str],
    merged: Merged,
    *,
    exposure_nominal_s: Sequence[float],
    files: Sequence[str],
    cfa: NDArray[np.int64],
    channels: Sequence[str],
) -> None:
    """Write a merge as compressed .npz; it appears under its name complete.

    Keys: radiance (DN/s), variance ((DN/s)^2), flags (`Flag` bits), each (H, W); exposure_s (as used),
    exposure_nominal_s, files, each (N,); clip_dn, cfa, each (2, 2); channels. Where the merge holds them:
    chi_square (weighted sum of squared residuals over their variances) and samples (how many), each (H, W).

    Parameters
    ----------
    path : path
        The file, replaced where it exists.
    merged : Merged
        What to write.
    exposure_nominal_s : sequence of float
        Stated exposure times.
    files : sequence of str
        Names of the frames.
    cfa, channels
        As in `RawFrame`.

    Raises
    ------
    BadInput, Refused
        The file cannot be written, or the disk is full; an earlier file stays.
    """
    asked = {"chi_square": merged.chi_square, "samples": merged.samples}
    maps: dict[str, Any] = {name: values for name, values in asked.items() if values is not None}
    with whole_file(path) as place, place.open("wb") as file:
        np.savez_compressed(
            file,
            radiance=merged.radiance,
            variance=merged.variance,
            flags=merged.flags,
            exposure_s=np.asarray(merged.report.exposure_s),
            exposure_nominal_s=np.asarray(exposure_nominal_s),
            clip_dn=np.reshape(np.asarray(merged.report.clip_dn), (2, 2)),
            cfa=cfa,
            channels=np.asarray(channels),
            files=np.asarray(files),
            **maps,
        )


@dataclass(frozen=True, eq=False)
class StoredRadiance:
    """What `write_radiance` wrote, as far as a picture needs it.

    Attributes
    ----------
    radiance : ndarray, shape (H, W)
        DN/s.
    variance : ndarray, shape (H, W)
        (DN/s)^2.
    flags : ndarray of uint8, shape (H, W)
        `Flag` bits.
    cfa : ndarray of int, shape (2, 2)
    channels : tuple of str
    """

    radiance: NDArray[np.float64]
    variance: NDArray[np.float64]
    flags: NDArray[np.uint8]
    cfa: NDArray[np.int64]
    channels: tuple[str, ...]


def read_radiance(path: str | os.PathLike[str]) -> StoredRadiance:
    """Read a merge back.

    Raises
    ------
    BadInput
        It is missing, damaged, or no merge.
    """
    todo = "give a file of gonio merge --out"
    try:
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
            radiance, variance, flags, cfa, channels = (
                archive[name] for name in ("radiance", "variance", "flags", "cfa", "channels")
            )
    except OSError as error:
        what = f"cannot read: {error.strerror or 'it is no .npz'}"
        raise BadInput(what, where=str(path), todo=todo) from None
    except (KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        raise BadInput("no merge, or a damaged one", where=str(path), todo=todo) from None
    names = tuple(str(name) for name in np.atleast_1d(channels))
    shapes = {radiance.shape, variance.shape, flags.shape}
    if (
        radiance.ndim != 2
        or len(shapes) != 1
        or cfa.shape != (2, 2)
        or not set(cfa.ravel().tolist()) <= set(range(len(names)))
        or flags.dtype != np.uint8
    ):
        raise BadInput("arrays that do not belong together", where=str(path), todo=todo)
    radiance, variance = radiance.astype(np.float64), variance.astype(np.float64)
    return StoredRadiance(radiance, variance, flags, cfa.astype(np.int64), names)


def preview(merged: Merged, cfa: NDArray[np.int64], channels: Sequence[str]) -> NDArray[np.uint8]:
    """Picture of a merge at half size: one pixel per 2 x 2 cell, logarithmic over four decades at most.

    Hot and inconsistent pixels are filled with the median of their cell neighbours, here only.

    Parameters
    ----------
    merged : Merged
        Radiance and flags.
    cfa, channels
        As in `RawFrame`.

    Returns
    -------
    ndarray of uint8, shape (H // 2, W // 2, 3)
        Red, green, blue, each channel scaled to its own 99.5th percentile.
    """
    rows, cols = (size // 2 * 2 for size in merged.radiance.shape)
    bad = (merged.flags[:rows, :cols] & np.uint8(_FILL)) != 0
    filled = np.where(
        bad, _same_position_median(merged.radiance[:rows, :cols]), merged.radiance[:rows, :cols]
    )
    planes = []
    for channel in range(len(channels)):
        places = [(row, col) for row in (0, 1) for col in (0, 1) if cfa[row, col] == channel]
        plane = np.mean([filled[row::2, col::2] for row, col in places], axis=0)
        top = max(float(np.percentile(plane, 99.5)), 1e-30)
        floor = max(float(np.percentile(plane, 0.5)) / top, 1e-4)
        planes.append(1.0 - np.log10(np.clip(plane / top, floor, 1.0)) / np.log10(min(floor, 0.5)))
    if len(planes) == 1:
        planes *= 3
    return np.rint(np.stack(planes, axis=-1) * 255.0).astype(np.uint8)


def _same_position_median(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Median of the eight nearest pixels at the same position of the cell."""
    padded = np.pad(values, 2, mode="reflect")
    rows, cols = values.shape
    shifts = [(row, col) for row in (0, 2, 4) for col in (0, 2, 4) if (row, col) != (2, 2)]
    return np.median([padded[row : row + rows, col : col + cols] for row, col in shifts], axis=0)
