"""MERL's binary tables (Matusik et al. 2003): isotropic, half and difference angles, linear RGB.

    int32 90, 90, 180   float64 planes R, G, B, little-endian; a plane's index is
                        phi_d + 180 (theta_d + 90 theta_h)

theta_h is in bins of equal square root, floor(90 sqrt(2 theta_h / pi)), theta_d and phi_d in bins of a
degree; phi_d covers half a turn, the other half follows from reciprocity (some writers give all 360). Values
are f_r divided by 1/1500, 1.15/1500, 1.66/1500; negative ones mean that there is none, so what is negative
in the samples is written as 0. Values belong to the middle of their bin.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.formats.loss import Loss, compared
from analysis.formats.scattered import Usable, interpolant_of, usable
from analysis.samples import make_samples
from rig.angles import from_half_difference, half_difference, unit
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

    from analysis.interpolation import Interpolant

Array = NDArray[np.float64]

NAME = "MERL .binary"
OPTIONS: tuple[str, ...] = ()
SUFFIX = ".binary"
CHANNELS = ("R", "G", "B")
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
THETA_H, THETA_D = 90, 90
PHI_D = (180, 360)
"""How many bins of phi_d there may be, of a degree each."""

NONE = -1.0
ON_CENTRE = 1e-6
"""How near to a bin's middle, in bins, a sample stands on it."""

PHI_STEP = 5
"""Azimuths, in bins, that are looked up: with the other angles fixed, f_r changes slowly along phi_d."""

HORIZON_COSINE = 0.01
"""f_r at the horizon is taken from so far above it."""

CHUNK = 50_000


def sniff(head: bytes) -> bool:
    """Whether the file starts with the table's dimensions, in either byte order."""
    return any(
        head.startswith(struct.pack(order, THETA_H, THETA_D, phi))
        for order in ("<3i", ">3i")
        for phi in PHI_D
    )


def read(path: Path) -> xr.Dataset:
    """Read the bins that have a value and lie above the surface, one sample each.

    Raises
    ------
    BadInput
        If the file is big-endian, of another size than its dimensions say, or a value is not finite.
    """
    planes = read_table(path)
    wi, wo = bin_directions(planes.shape[-1])
    flat = planes.reshape(3, -1)
    known = (flat >= 0.0).all(axis=0) & (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
    if not known.any():
        raise BadInput("no bin has a value", where=str(path), todo="copy the file again")
    return make_samples(wi[known], wo[known], flat[:, known].T * SCALE, channels=CHANNELS, source=path.name)


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write samples: those in the middle of bins as they are, others interpolated.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples of an isotropic surface in three channels, or one that becomes grey; those with flags are left
        out.
    path : Path
        Where to.

    Returns
    -------
    Loss
        How far the table is from the samples.

    Raises
    ------
    BadInput
        If the samples are too few, lie in one plane, or have another number of channels.
    """
    given = usable(samples)
    if given.f_r.shape[1] not in {1, 3}:
        raise BadInput(
            f"{given.f_r.shape[1]} channels", where="samples", todo="this format holds three channels, or one"
        )
    given = Usable(*given[:2], *(np.broadcast_to(column, (len(column), 3)) for column in given[2:]))
    planes, cells, filled = _on_bins(given)
    write_table(path, planes)
    back = evaluate(planes, given.wi, given.wo)
    return compared(samples, *given[:3], back, cells=cells, filled=filled)


def read_table(path: Path) -> Array:
    """Read the stored numbers as they are.

    Returns
    -------
    ndarray, shape (3, theta_h, theta_d, phi_d)

    Raises
    ------
    BadInput
        As `read`.
    """
    with path.open("rb") as stream:
        head = stream.read(12)
        if not sniff(head):
            raise BadInput("does not start with 90, 90, 180", where=f"{path}: byte 0", todo="is it MERL's?")
        sizes = struct.unpack("<3i", head)
        if sizes[0] != THETA_H:
            raise BadInput(
                "is big-endian", where=f"{path}: byte 0", todo="write it little-endian, as MERL does"
            )
        expected, size = 12 + 3 * 8 * sizes[0] * sizes[1] * sizes[2], path.stat().st_size
        if size != expected:
            raise BadInput(
                f"has {size} bytes, not the {expected} of its dimensions",
                where=f"{path}: byte {min(size, expected)}",
                todo="copy it again",
            )
        planes = np.frombuffer(stream.read(), "<f8").reshape(3, *sizes)
    wrong = np.flatnonzero(~np.isfinite(planes))
    if wrong.size:
        raise BadInput("is not a finite number", where=f"{path}: byte {12 + 8 * int(wrong[0])}")
    return planes


def write_table(path: Path, planes: Array) -> None:
    """Write stored numbers (3, 90, 90, 180 or 360) as they are, the inverse of `read_table`."""
    channels, *sizes = planes.shape
    if channels != 3 or sizes[:2] != [THETA_H, THETA_D] or sizes[2] not in PHI_D:
        raise BadInput(f"has the shape {planes.shape}, not (3, 90, 90, 180)", where="table")
    with path.open("wb") as stream:
        stream.write(struct.pack("<3i", *sizes))
        stream.write(np.ascontiguousarray(planes, "<f8").tobytes())


def bin_directions(phi_bins: int = PHI_D[0]) -> tuple[Array, Array]:
    """Directions to light and camera of the middle of each bin, shape (N, 3), in the order of a plane."""
    theta_h = ((np.arange(THETA_H) + 0.5) / THETA_H) ** 2 * (np.pi / 2.0)
    theta_d = np.radians(np.arange(THETA_D) + 0.5)
    phi_d = np.radians(np.arange(phi_bins) + 0.5)
    grid = np.meshgrid(theta_h, theta_d, phi_d, indexing="ij")
    wi, wo = from_half_difference(grid[0], 0.0, grid[1], grid[2])
    return wi.reshape(-1, 3), wo.reshape(-1, 3)


def bin_index(wi: Array, wo: Array, phi_bins: int = PHI_D[0]) -> NDArray[np.intp]:
    """Index within a plane of the bin that directions lie in, shape (N,)."""
    return _index(np.floor(_in_bins(wi, wo, phi_bins)), phi_bins)


def evaluate(planes: Array, wi: Array, wo: Array) -> Array:
    """Give the value of the bin that directions lie in, as MERL's own reader does.

    Returns
    -------
    ndarray, shape (N, 3)
        f_r in 1/sr; negative where the table has none.
    """
    flat = planes.reshape(3, -1)
    return np.asarray(flat[:, bin_index(wi, wo, planes.shape[-1])].T * SCALE)


def _in_bins(wi: Array, wo: Array, phi_bins: int) -> Array:
    """Angles in bins, shape (3, N): the whole part is the bin."""
    theta_h, _, theta_d, phi_d = half_difference(wi, wo)
    turn = np.radians(phi_bins)
    return np.stack(
        [
            THETA_H * np.sqrt(np.clip(theta_h, 0.0, None) * (2.0 / np.pi)),
            np.degrees(theta_d),
            np.degrees(phi_d - turn * np.floor(phi_d / turn)),
        ]
    )


def _index(bins: Array, phi_bins: int) -> NDArray[np.intp]:
    h, d, p = np.clip(bins.astype(np.intp).T, 0, [THETA_H - 1, THETA_D - 1, phi_bins - 1]).T
    return np.asarray(p + phi_bins * (d + THETA_D * h))


def _on_bins(given: Usable) -> tuple[Array, int, int]:
    """Return the stored numbers, the bins above the surface, and those without samples nearby."""
    flat = np.full((3, THETA_H * THETA_D * PHI_D[0]), NONE)
    place = _in_bins(given.wi, given.wo, PHI_D[0])
    if np.abs(place - np.floor(place) - 0.5).max() < ON_CENTRE:
        flat[:, _index(np.floor(place), PHI_D[0])] = np.maximum(given.f_r / SCALE, 0.0).T
        return flat.reshape(3, THETA_H, THETA_D, -1), len(given.wi), 0
    return _interpolated(interpolant_of(given))


def _interpolated(interpolant: Interpolant) -> tuple[Array, int, int]:
    """Look up each fifth azimuth; what is between is linear, and half a turn leads back to the first."""
    wi, wo = bin_directions()
    shape = (THETA_H, THETA_D, PHI_D[0])
    above = ((wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)).reshape(shape)
    phi = np.arange(PHI_STEP // 2, PHI_D[0], PHI_STEP)
    wanted = above.reshape(*shape[:2], -1, PHI_STEP).any(axis=-1)
    wanted |= np.roll(wanted, 1, axis=-1) | np.roll(wanted, -1, axis=-1)
    chosen = np.zeros(shape, dtype=bool)
    chosen[..., phi] = wanted
    rows = np.flatnonzero(chosen)
    f_r, hole = np.zeros((*wanted.shape, 3)), np.zeros(wanted.shape, dtype=bool)
    parts = [
        interpolant(_lifted(wi[some]), _lifted(wo[some]))
        for some in np.array_split(rows, max(1, rows.size // CHUNK))
    ]
    f_r[wanted] = np.concatenate([part.f_r for part in parts])
    hole[wanted] = np.concatenate([part.hole for part in parts])
    place = (np.arange(PHI_D[0]) - PHI_STEP // 2) / PHI_STEP
    left = np.floor(place).astype(int)
    right, part = (left + 1) % phi.size, (place - left)[:, None]
    between = (1.0 - part) * f_r[:, :, left] + part * f_r[:, :, right]
    planes = np.where(above[..., None], np.maximum(between / SCALE, 0.0), NONE)
    nearest = hole[:, :, np.arange(PHI_D[0]) // PHI_STEP]
    return np.moveaxis(planes, -1, 0), int(above.sum()), int((above & nearest).sum())


def _lifted(directions: Array) -> Array:
    """Directions, those below the horizon lifted above it."""
    lifted = directions.copy()
    lifted[:, 2] = np.maximum(lifted[:, 2], HORIZON_COSINE)
    return unit(lifted)
