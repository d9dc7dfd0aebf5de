"""From scattered samples to an isotropic table of a measured BSDF, and from a formula to any.

A written table has no warp of its own: its nodes are even in half-vector coordinates, and a profile along
theta_h takes the peak's steepness out of the values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.loss import Loss, compared
from analysis.formats.rgl_layout import LAYOUT
from analysis.formats.rgl_table import Table
from analysis.formats.scattered import Usable, interpolant_of, usable
from analysis.interpolation.trend import fit_trend
from rig.angles import spherical_to_direction, turned, unit
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

    from analysis.interpolation import Interpolant

Array = NDArray[np.float64]
Profile = Callable[[Array], Array]
"""Positive function of the half vector's radius sqrt(2 theta_h / pi)."""

Lookup = Callable[[Array, Array], tuple[Array, NDArray[np.bool_]]]

SIDES = (97, 145, 193, 289, 385)
"""Nodes of a written table along the half vector's azimuth and polar angle: Mitsuba wants a square."""

FORMULA_SIDE = 193
"""The same of a table that a formula fills."""

LARGEST_BYTES = 64_000_000
"""A table that grows beyond this is not made finer."""

LOSS_FALLS = 1.5
"""Power of the size with which a table's loss falls: measured on tables with texture."""

FINE_ENOUGH, OF_BETWEEN = 0.002, 0.25
"""A table is to give the samples back to this, or to this part of what is not known between them: median
relative error off the peak."""

ASKED_BETWEEN = 2000
"""Pairs of directions at which the uncertainty between samples is looked up."""

STEPS_IN_SPACING = 2.0
"""Nodes along the radius in the distance between the densest samples, if the largest side allows so many."""

AZIMUTH_STEP = 3
"""Only each third azimuth is looked up, what is between is linear: surfaces change faster along theta_h."""

LARGEST_STEP_RAD = np.radians(3.0)
"""Step between the polar angles of the light in a written table; those of the samples are all among them."""

FORMULA_THETA_I = np.radians(np.append(np.arange(0.0, 88.0, 2.0), [88.0, 89.5]))
"""Polar angles of the light of a table that a formula fills."""

FORMULA_PHI_I = np.radians(np.arange(-180.0, 1.0, 10.0))
FORMULA_THETA_I_GRAINED = np.radians(np.append(np.arange(0.0, 88.0, 4.0), [88.0, 89.5]))
"""Azimuths and polar angles of the light of a table that an anisotropic formula fills."""

HORIZON_COSINE = 0.01
"""f_r at the horizon is taken from so far above it."""

PROFILE_COLUMNS = 513

MOST_AT_ONCE = 4_000_000
"""Values looked up at a time: polar angles of the light share most of the work, memory bounds how many."""


def resample(samples: xr.Dataset) -> tuple[dict[str, NDArray[Any]], Loss]:
    """Interpolate samples onto the nodes of a table; see `write`.

    Returns
    -------
    tensors : dict of str to ndarray
        What a tensor file of a measured BSDF holds.
    loss : Loss
        How far the table is from the samples.
    """
    given, wavelengths = as_colours(usable(samples), samples)
    interpolant = interpolant_of(given)
    profile = interpolant.trend.profile

    def between(wi: Array, wo: Array) -> tuple[Array, NDArray[np.bool_]]:
        found = interpolant(wi, wo)
        return found.f_r, found.hole

    u_between = between_samples(interpolant, given)
    theta_i, channels = incidences(interpolant), given.f_r.shape[1]
    source = str(samples.attrs.get("source", ""))

    def made(side: int) -> tuple[dict[str, NDArray[Any]], Loss]:
        grid = nodes(between, profile, theta_i, side, channels)
        tensors = tensors_of(grid.theta_i, grid.values, profile, wavelengths, source)
        back = Table(tensors, "samples").evaluate(given.wi, given.wo) / given.wo[:, 2:]
        loss = compared(
            samples, *given[:3], back, cells=grid.cells, filled=grid.filled, kept=("wavelength_nm", LAYOUT)
        )
        return tensors, loss

    side = side_for(interpolant)
    tensors, loss = made(side)
    wanted = max(FINE_ENOUGH, OF_BETWEEN * u_between)
    finer = _finer(side, loss.median_relative / wanted, theta_i.size * channels)
    if finer > side:
        tensors, loss = made(finer)
    return tensors, replace(loss, u_between_relative=u_between)


def as_colours(given: Usable, samples: xr.Dataset) -> tuple[Usable, Array | None]:
    """Return samples in channels that a table holds, one as grey, and their wavelengths if known.

    Raises
    ------
    BadInput
        If there are two channels, or more than three, without wavelengths.
    """
    wavelengths = samples["wavelength_nm"].to_numpy() if "wavelength_nm" in samples.coords else None
    if wavelengths is None and given.f_r.shape[1] == 1:
        given = Usable(*given[:2], *(np.repeat(column, 3, axis=1) for column in given[2:]))
    if wavelengths is None and given.f_r.shape[1] != 3:
        raise BadInput(
            f"{given.f_r.shape[1]} channels without wavelengths",
            where="samples",
            todo="this format holds one channel, three, or known wavelengths",
        )
    return given, wavelengths


def table_of(
    evaluate: Callable[[Array, Array], Array],
    source: str,
    *,
    side: int = FORMULA_SIDE,
    isotropic: bool = True,
) -> dict[str, NDArray[Any]]:
    """Evaluate a formula onto a table of linear RGB.

    Parameters
    ----------
    evaluate : callable
        (wi, wo) -> f_r (N, 3).
    source : str
        What the formula is.
    side : int
        Nodes along the half vector's angles, one of `SIDES`.
    isotropic : bool
        Whether the light's azimuth does not matter. Else the surface looks the same after half a turn.
    """
    theta = np.radians(np.linspace(0.0, 88.0, 12))
    grid = np.meshgrid(theta, theta, np.linspace(0.0, np.pi, 12), indexing="ij")
    wi, wo = (
        spherical_to_direction(polar.ravel(), azimuth.ravel())
        for polar, azimuth in ((grid[0], np.zeros_like(grid[0])), (grid[1], grid[2]))
    )
    wi, wo = np.concatenate([wi, wi]), np.concatenate([wo, unit(wi * [-1.0, -1.0, 1.0] + 0.2 * wo)])
    lights = np.zeros(1) if isotropic else FORMULA_PHI_I
    turns = lights[np.arange(len(wi)) % lights.size]
    wi, wo = turned(wi, turns), turned(wo, turns)
    profile = fit_trend(wi, wo, evaluate(wi, wo)).profile

    def everywhere(wi: Array, wo: Array) -> tuple[Array, NDArray[np.bool_]]:
        return evaluate(wi, wo), np.zeros(len(wi), dtype=bool)

    theta_i = FORMULA_THETA_I if isotropic else FORMULA_THETA_I_GRAINED
    values = np.stack([nodes(everywhere, profile, theta_i, side, 3, phi_i=phi_i).values for phi_i in lights])
    if isotropic:
        return tensors_of(theta_i, values[0], profile, None, source)
    return tensors_of(theta_i, values, profile, None, source, phi_i=lights)


def tensors_of(
    theta_i: Array,
    values: Array,
    profile: Profile,
    wavelengths: Array | None,
    source: str,
    *,
    phi_i: Array | None = None,
) -> dict[str, NDArray[Any]]:
    """Put a table together.

    Parameters
    ----------
    theta_i : ndarray, shape (T,)
        Increasing polar angles of the light, in radians.
    values : ndarray, shape (T, C, S, S), or (P, T, C, S, S)
        f_r cos(theta_o) / profile; rows along the half vector's azimuth, columns along its radius.
    profile : callable
        Positive function of the half vector's radius sqrt(2 theta_h / pi).
    wavelengths : ndarray, shape (C,), or None
        In nm; None for linear RGB.
    source : str
        Where the values come from.
    phi_i : ndarray, shape (P,), optional
        Increasing azimuths of the light of an anisotropic surface, whose half vectors count from its mark.
    """
    if phi_i is None:
        phi_i, values = np.zeros(1), values[None]
    density = np.stack([_sampling_density(profile, each) for each in values])
    tensors: dict[str, NDArray[Any]] = {
        "theta_i": theta_i.astype(np.float32),
        "phi_i": phi_i.astype(np.float32),
        "sigma": np.full((2, 2), 0.25, np.float32),
        "ndf": np.tile(profile(np.linspace(0.0, 1.0, PROFILE_COLUMNS)), (2, 1)).astype(np.float32),
        "vndf": np.ones((phi_i.size, theta_i.size, 2, 2), np.float32),
        "luminance": density.astype(np.float32),
        "rgb" if wavelengths is None else "spectra": values.astype(np.float32),
        "jacobian": np.ones(1, np.uint8),
        "description": np.frombuffer(f"gonio: {source}".encode(), np.uint8),
    }
    if wavelengths is not None:
        tensors["wavelengths"] = wavelengths.astype(np.float32)
    return tensors


class Grid(NamedTuple):
    """A table's polar angles and values; nodes above the surface, and those without samples nearby."""

    theta_i: Array
    values: Array
    cells: int
    filled: int


def incidences(interpolant: Interpolant) -> Array:
    """Return polar angles of the light: those of the samples' layers, and steps small enough between."""
    ends = interpolant.theta_i if interpolant.theta_i.size else np.array([0.0, interpolant.largest_theta_i])
    steps = np.maximum(np.ceil(np.diff(ends) / LARGEST_STEP_RAD - 1e-6), 1).astype(int)
    parts = [
        np.linspace(below, above, step, endpoint=False)
        for below, above, step in zip(ends[:-1], ends[1:], steps, strict=True)
    ]
    return np.concatenate([*parts, ends[-1:]])


def side_for(interpolant: Interpolant) -> int:
    """Choose the size that the samples' density asks for: more nodes would only hold interpolation."""
    # Samples of one place have no spacing, and ask for the finest.
    finest = max(interpolant.finest_radius, STEPS_IN_SPACING / FORMULA_SIDE)
    wanted = STEPS_IN_SPACING / finest + 1.0
    return next((side for side in SIDES if side >= wanted), FORMULA_SIDE)


def _finer(side: int, excess: float, planes: int) -> int:
    """Choose the size at which the loss would be less by the factor `excess`, as far as memory allows."""
    most = np.sqrt(LARGEST_BYTES / (planes * np.dtype(np.float32).itemsize))
    allowed = [each for each in SIDES if each >= side and each <= max(most, side)]
    wanted = side * max(excess, 1.0) ** (1.0 / LOSS_FALLS)
    return next((each for each in allowed if each >= wanted), allowed[-1])


def between_samples(interpolant: Interpolant, given: Usable) -> float:
    """Median of u over |f_r| between samples: lights of some with the views of others."""
    rng = np.random.default_rng(0)
    lights, views = (rng.integers(len(given.wi), size=ASKED_BETWEEN) for _ in range(2))
    found = interpolant(given.wi[lights], given.wo[views])
    known = ~found.hole[:, None] & (found.f_r != 0.0)
    relative = found.u_f_r[known] / np.abs(found.f_r[known])
    return float(np.median(relative)) if relative.size else 0.0


def nodes(
    lookup: Lookup, profile: Profile, theta_i: Array, side: int, channels: int, *, phi_i: float = 0.0
) -> Grid:
    """Values over the profile; `lookup` gives f_r (N, C) and where it is a guess (N,).

    Only each third azimuth is looked up; f_r between them is linear, its cosine exact. Below the horizon f_r
    is that of the horizon and the cosine keeps its negative sign, so that what lies between a node above and
    one below runs through zero where it should.
    """
    half = _half_vectors(side)
    over = profile(np.linspace(0.0, 1.0, side))[:, None]
    at_once = max(1, MOST_AT_ONCE // (half.size // 3 // AZIMUTH_STEP * channels))
    values, cells, filled = [], 0, 0
    for some in np.array_split(theta_i, -(-theta_i.size // at_once)):
        lights = [np.broadcast_to(spherical_to_direction(theta, phi_i), half.shape) for theta in some]
        cameras = [unit(2.0 * (light * half).sum(-1, keepdims=True) * half - light) for light in lights]
        rows = [_near_the_horizon(camera[::AZIMUTH_STEP, :, 2]) for camera in cameras]
        wanted = [camera[::AZIMUTH_STEP][row] for camera, row in zip(cameras, rows, strict=True)]
        asked = np.concatenate([light[::AZIMUTH_STEP][row] for light, row in zip(lights, rows, strict=True)])
        found, hole = lookup(asked, _lifted(np.concatenate(wanted)))
        ends = np.cumsum([len(part) for part in wanted])[:-1]
        for camera, row, f_r in zip(cameras, rows, np.split(found, ends), strict=True):
            coarse = np.zeros((*row.shape, channels))
            coarse[row] = f_r
            values.append(np.moveaxis(_all_azimuths(coarse) * camera[..., 2:] / over, -1, 0))
        above = np.concatenate(wanted)[:, 2] > 0.0
        cells += int(np.count_nonzero(above))
        filled += int(np.count_nonzero(hole & above))
    return Grid(theta_i, np.stack(values), cells, filled)


def _half_vectors(side: int) -> Array:
    """Half vectors of the nodes, shape (azimuths, radii, 3)."""
    radius, phi = np.linspace(0.0, 1.0, side), np.linspace(-np.pi, np.pi, side)
    return spherical_to_direction(*np.meshgrid(radius**2 * (np.pi / 2.0), phi))


def _all_azimuths(coarse: Array) -> Array:
    """Fill in the azimuths between each third one, along the first axis."""
    filled = np.empty((AZIMUTH_STEP * (len(coarse) - 1) + 1, *coarse.shape[1:]))
    filled[::AZIMUTH_STEP] = coarse
    for step in range(1, AZIMUTH_STEP):
        part = step / AZIMUTH_STEP
        filled[step::AZIMUTH_STEP] = (1.0 - part) * coarse[:-1] + part * coarse[1:]
    return filled


def _near_the_horizon(cosine: Array) -> NDArray[np.bool_]:
    """Nodes (azimuths, radii) above the horizon and their neighbours below: no others are looked up."""
    above = cosine > 0.0
    grown = above.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            grown |= np.roll(grown, step, axis=axis)
    return grown


def _lifted(camera: Array) -> Array:
    """Directions, those below the horizon lifted above it."""
    lifted = camera.copy()
    lifted[:, 2] = np.maximum(lifted[:, 2], HORIZON_COSINE)
    return unit(lifted)


def _sampling_density(profile: Callable[[Array], Array], values: Array) -> Array:
    """Density (theta_i, rows, columns) that renderers draw directions from: positive everywhere."""
    brightness = values.mean(axis=1) * profile(np.linspace(0.0, 1.0, values.shape[-1]))
    floored: Array = np.maximum(brightness, 1e-3 * np.abs(brightness).max(axis=(1, 2), keepdims=True) + 1e-30)
    return floored
