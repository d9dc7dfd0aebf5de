"""Sets of poses, as pairs of directions.

Every generator is pure and returns ``(wi, wo)``, both of shape (N, 3), in the sample's frame. Angles are
radians. The light's azimuth is given; the camera's is told relative to it, so that phi = pi is the side to
which a mirror reflects.
"""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rig.angles import FloatArray, spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

Directions = tuple[FloatArray, FloatArray]

CSV_COLUMNS = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")

LARGEST_SET = 100_000
"""More poses than any machine visits in a month; a plan beyond it is a slip of the pen."""

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_SAME = 1e-9


def grid(
    theta_i: npt.ArrayLike, theta_o: npt.ArrayLike, phi: npt.ArrayLike, phi_i: npt.ArrayLike = 0.0
) -> Directions:
    """Every combination of the angles given.

    Parameters
    ----------
    theta_i, theta_o : array_like, shape (A,), (B,)
        Polar angles of light and camera.
    phi : array_like, shape (C,)
        Azimuth of the camera minus that of the light.
    phi_i : array_like, shape (D,)
        Azimuth of the light.

    Returns
    -------
    wi, wo : ndarray, shape (A * B * C * D, 3)
    """
    axes = [np.atleast_1d(np.asarray(axis, dtype=np.float64)) for axis in (phi_i, theta_i, theta_o, phi)]
    light_phi, light_theta, camera_theta, relative = (
        axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")
    )
    return (
        spherical_to_direction(light_theta, light_phi),
        spherical_to_direction(camera_theta, light_phi + relative),
    )


def sweep(theta_i: npt.ArrayLike, theta_o: npt.ArrayLike, phi_i: float = 0.0) -> Directions:
    """Sweeps in the plane of incidence.

    Parameters
    ----------
    theta_i : array_like, shape (A,)
        Polar angles of the light.
    theta_o : array_like, shape (B,)
        Signed polar angles of the camera: positive on the far side from the light, so that theta_o = theta_i
        is the mirror direction.
    phi_i : float
        Azimuth of the light.

    Returns
    -------
    wi, wo : ndarray, shape (A * B, 3)
    """
    return grid(theta_i, theta_o, math.pi, phi_i)


def specular(theta_i: npt.ArrayLike, offset: npt.ArrayLike, phi_i: float = 0.0) -> Directions:
    """Poses about the mirror direction, in the plane of incidence.

    Parameters
    ----------
    theta_i : array_like, shape (A,)
        Polar angles of the light.
    offset : array_like, shape (B,)
        How much farther from the normal the camera stands than the mirror direction.
    phi_i : float
        Azimuth of the light.

    Returns
    -------
    wi, wo : ndarray, shape (A * B, 3)
    """
    light, off = (
        axis.ravel() for axis in np.meshgrid(np.atleast_1d(theta_i), np.atleast_1d(offset), indexing="ij")
    )
    return (
        spherical_to_direction(light, np.full_like(light, phi_i)),
        spherical_to_direction(light + off, np.full_like(light, phi_i + math.pi)),
    )


def hemisphere(theta_i: npt.ArrayLike, count: int, theta_o_max: float, phi_i: float = 0.0) -> Directions:
    """Camera directions spread evenly over a cap, for each light direction.

    They lie on a spiral of the golden angle, each on the same solid angle (Swinbank and Purser 2006,
    "Fibonacci grids", section 2).

    Parameters
    ----------
    theta_i : array_like, shape (A,)
        Polar angles of the light.
    count : int
        Camera directions for each.
    theta_o_max : float
        Largest polar angle of the camera.
    phi_i : float
        Azimuth of the light.

    Returns
    -------
    wi, wo : ndarray, shape (A * count, 3)
    """
    number = np.arange(count) + 0.5
    theta_o = np.arccos(1.0 - number / count * (1.0 - math.cos(theta_o_max)))
    camera = spherical_to_direction(theta_o, phi_i + number * _GOLDEN_ANGLE)
    lights = np.atleast_1d(np.asarray(theta_i, dtype=np.float64))
    light = spherical_to_direction(lights, np.full_like(lights, phi_i))
    return np.repeat(light, count, axis=0), np.tile(camera, (lights.size, 1))


def listed(angles: npt.ArrayLike) -> Directions:
    """Poses as they are.

    Parameters
    ----------
    angles : array_like, shape (N, 4)
        theta_i, phi_i, theta_o, phi_o.

    Returns
    -------
    wi, wo : ndarray, shape (N, 3)
    """
    table = np.asarray(angles, dtype=np.float64).reshape(-1, 4)
    return spherical_to_direction(table[:, 0], table[:, 1]), spherical_to_direction(table[:, 2], table[:, 3])


def read_csv(path: Path) -> list[tuple[float, float, float, float]]:
    """Read a list of poses.

    Parameters
    ----------
    path : Path
        A table with the columns theta_i_deg, phi_i_deg, theta_o_deg, phi_o_deg, named in its first line.

    Returns
    -------
    list of tuple of float
        The four angles of each pose in degrees.

    Raises
    ------
    BadInput
        The file cannot be read, a column is missing, a value is no finite number, or a theta lies outside
        0 to 90 degrees.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(
            error.strerror or "unreadable", where=str(path), todo="give a CSV file of poses"
        ) from None
    except UnicodeDecodeError:
        raise BadInput("not text", where=str(path), todo="save the table as CSV in UTF-8") from None
    rows = csv.reader(io.StringIO(text))
    header = [name.strip() for name in next(rows, [])]
    missing = [name for name in CSV_COLUMNS if name not in header]
    if missing:
        raise BadInput(
            f"no column {missing[0]}", where=str(path), todo=f"name {','.join(CSV_COLUMNS)} in its first line"
        )
    places = [header.index(name) for name in CSV_COLUMNS]
    poses = [
        _row(row, places, f"{path} line {rows.line_num}") for row in rows if any(cell.strip() for cell in row)
    ]
    if not poses:
        raise BadInput("no pose in it", where=str(path), todo="add one line for each pose")
    return poses


def _row(row: list[str], places: Sequence[int], where: str) -> tuple[float, float, float, float]:
    angles = []
    for name, place in zip(CSV_COLUMNS, places, strict=True):
        cell = row[place].strip() if place < len(row) else ""
        try:
            angle_deg = float(cell)
        except ValueError:
            angle_deg = math.nan
        if not math.isfinite(angle_deg) or (name.startswith("theta") and not 0.0 <= angle_deg <= 90.0):
            allowed = "0 to 90 degrees" if name.startswith("theta") else "a number of degrees"
            raise BadInput(f"{name} is {cell!r}, expected {allowed}", where=where, todo="mend that line")
        angles.append(angle_deg)
    return angles[0], angles[1], angles[2], angles[3]


def without_repeats(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Drop poses that are the same pair of directions as an earlier one.

    A grid names the pole once for every azimuth; it is one pose.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)

    Returns
    -------
    wi, wo : ndarray, shape (M, 3)
        The first of each, in the same order.
    repeats : int
        N - M.
    """
    keys = np.round(np.concatenate([wi, wo], axis=1) / _SAME).astype(np.int64)
    _, first = np.unique(keys, axis=0, return_index=True)
    kept = np.sort(first)
    return wi[kept], wo[kept], len(wi) - len(kept)
