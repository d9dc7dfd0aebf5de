"""The hot pixels of a sensor's calibration, `calibration/hot_pixels.toml` beside its noise model.

The file lists pixels by their number, row by row: a few thousand of millions. A session keeps a copy.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.errors import BadInput
from rig.files import whole_file

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

HOT_PIXELS_FILE = "hot_pixels.toml"
FORMAT_VERSION = 1
_AGAIN = "run gonio calibrate sensor, or take the file away"


def save_hot_pixels(hot: NDArray[np.bool_], path: str | os.PathLike[str]) -> None:
    """Write a map of hot pixels.

    Parameters
    ----------
    hot : ndarray of bool, shape (H, W)
    path : path
        The file, replaced where it exists.

    Raises
    ------
    BadInput, Refused
        The file cannot be written; an earlier one stays.
    """
    numbers = ", ".join(map(str, np.flatnonzero(hot)))
    lines = [
        f"version = {FORMAT_VERSION}",
        f"height_px = {hot.shape[0]}",
        f"width_px = {hot.shape[1]}",
        f"pixels = [{numbers}]  # row * width_px + column",
    ]
    with whole_file(Path(path)) as file:
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def load_hot_pixels(path: str | os.PathLike[str]) -> NDArray[np.bool_] | None:
    """Read a map of hot pixels.

    Parameters
    ----------
    path : path
        As `save_hot_pixels` writes it.

    Returns
    -------
    ndarray of bool, shape (H, W), or None
        None where there is no such file.

    Raises
    ------
    BadInput
        The file is not such a map, or names pixels outside it.
    """
    path = Path(path)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"not a map of hot pixels ({error})", where=str(path), todo=_AGAIN) from None
    size, pixels = [values.get(key) for key in ("height_px", "width_px")], values.get("pixels")
    if values.get("version") != FORMAT_VERSION or not _are_counts(size) or not _are_counts(pixels):
        raise BadInput("not a map of hot pixels that this gonio reads", where=str(path), todo=_AGAIN)
    hot = np.zeros((values["height_px"], values["width_px"]), dtype=np.bool_)
    if pixels and max(pixels) >= hot.size:
        what = f"it names pixel {max(pixels)} of {hot.size}"
        raise BadInput(what, where=str(path), todo=_AGAIN)
    hot.flat[np.asarray(pixels, dtype=np.int64)] = True
    return hot


def _are_counts(values: Any) -> bool:
    return isinstance(values, list) and all(type(value) is int and value >= 0 for value in values)
