"""From scans of a grained surface to a table of a measured BSDF with azimuths of the light.

Half vectors of such a table count from the sample's mark, not from the light, and what lies between two
azimuths of the light is linear at a fixed half vector. Samples have to come in scans, each with the light at
one azimuth, as a turning stage gives them. Each scan is interpolated alone, without the mirror and the
exchange of light and view that help with isotropic surfaces. Where the scans cover half a turn, the other
half is taken to look the same, as that of any surface does whose facets lean to both sides alike; Mitsuba
reads a table of half a turn so.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.loss import Loss, compared
from analysis.formats.rgl_layout import LAYOUT
from analysis.formats.rgl_resample import (
    LARGEST_BYTES,
    SIDES,
    Lookup,
    Profile,
    as_colours,
    between_samples,
    incidences,
    nodes,
    side_for,
    tensors_of,
)
from analysis.formats.rgl_table import Table
from analysis.formats.scattered import Usable, usable
from analysis.interpolation import Interpolant
from analysis.interpolation.interpolant import places
from analysis.interpolation.isotropy import MOST, azimuth_matters
from rig.angles import direction_to_spherical, turned
from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

AT_NORMAL = 1e-6
"""Sine of the light's polar angle below which it has no azimuth."""

SAME_AZIMUTH_RAD = np.radians(0.1)
LARGEST_GAP_RAD = np.radians(40.0)
"""Step between the azimuths of the light up to which what lies between them is not invented."""

MOST_SCANS, FEWEST_IN_SCAN = 48, 64


class Scan(NamedTuple):
    """Samples (M,) with the light at one azimuth; those with the light on the normal belong to all."""

    phi_i: float
    rows: Indices


def is_anisotropic(samples: xr.Dataset) -> bool:
    """Whether values depend on the light's azimuth; see `analysis.interpolation.isotropy`.

    Raises
    ------
    BadInput
        If too few samples can be used.
    """
    given = usable(samples)
    return azimuth_matters(places(given.wi, given.wo), given.wi, given.f_r) > MOST


def resample_anisotropic(samples: xr.Dataset) -> tuple[dict[str, NDArray[Any]], Loss]:
    """Interpolate scans of an anisotropic surface onto a table's nodes; see `analysis.formats.rgl.write`.

    Returns
    -------
    tensors : dict of str to ndarray
        What a tensor file of a measured BSDF holds.
    loss : Loss
        How far the table is from the samples. What happens between two azimuths of the light no scan tells.

    Raises
    ------
    BadInput
        If a scan lies in one plane, or there are channels that the format cannot hold.
    Refused
        If the samples are no scans, or leave out a part of the circle.
    """
    given, wavelengths = as_colours(usable(samples), samples)
    scans = scans_of(given.wi)
    parts = [_alone(given, scan) for scan in scans]
    fields = [_field(part) for part in parts]
    azimuths, order = closed([scan.phi_i for scan in scans])
    theta_i = incidences(max(fields, key=lambda field: field.theta_i.size))
    channels = given.f_r.shape[1]
    side = min(max(map(side_for, fields)), _largest_side(azimuths.size * theta_i.size * channels))
    profile = _profile(fields)
    grids = [
        nodes(_lookup(fields[number], phi_i), profile, theta_i, side, channels, phi_i=phi_i)
        for number, phi_i in zip(order, azimuths.tolist(), strict=True)
    ]
    values = np.stack([grid.values for grid in grids])
    source = str(samples.attrs.get("source", ""))
    tensors = tensors_of(theta_i, values, profile, wavelengths, source, phi_i=azimuths)
    back = Table(tensors, "samples").evaluate(given.wi, given.wo) / given.wo[:, 2:]
    loss = compared(
        samples,
        *given[:3],
        back,
        cells=sum(grid.cells for grid in grids),
        filled=sum(grid.filled for grid in grids),
        kept=("wavelength_nm", LAYOUT),
    )
    u_between = [between_samples(field, part) for field, part in zip(fields, parts, strict=True)]
    return tensors, replace(loss, u_between_relative=float(np.median(u_between)))


def scans_of(wi: Array) -> list[Scan]:
    """Sort samples by the light's azimuth, modulo half a turn where the scans do not fill the circle.

    Parameters
    ----------
    wi : ndarray, shape (N, 3)
        Directions to the light.

    Returns
    -------
    list of Scan
        Azimuths increase from -180 deg.

    Raises
    ------
    Refused
        If there are too many azimuths, too few samples at one, or a gap between them is too wide.
    """
    phi = direction_to_spherical(wi)[1]
    tilted = np.hypot(wi[:, 0], wi[:, 1]) > AT_NORMAL
    for period in (2.0 * np.pi, np.pi):
        # Counted from half a step below, so that what rounding puts to either side of the seam is one.
        place = np.mod(phi + np.pi + 0.5 * SAME_AZIMUTH_RAD, period)
        known = _distinct(place[tilted])
        if len(known) > 1 and np.diff([*known, known[0] + period]).max() <= LARGEST_GAP_RAD:
            break
    else:
        raise Refused(
            "are anisotropic, and their lights leave out more than "
            f"{np.degrees(LARGEST_GAP_RAD):.0f} deg of half a turn of azimuths",
            where="samples",
            todo="measure under lights around the sample, or turn it; or write .nc, .csv, .astm or .ssdd",
        )
    if len(known) > MOST_SCANS:
        raise Refused(
            f"are anisotropic, with lights at {len(known)} azimuths: they are no scans",
            where="samples",
            todo=f"measure under lights of {MOST_SCANS} azimuths at most; or write .nc, .csv, .astm or .ssdd",
        )
    near = [np.abs(place - azimuth) <= SAME_AZIMUTH_RAD for azimuth in known]
    found = [
        Scan(float(azimuth - np.pi - 0.5 * SAME_AZIMUTH_RAD), np.flatnonzero(rows | ~tilted))
        for azimuth, rows in zip(known, near, strict=True)
    ]
    small = next((scan for scan in found if len(scan.rows) < FEWEST_IN_SCAN), None)
    if small is not None:
        raise Refused(
            f"are anisotropic, and only {len(small.rows)} of them have the light at "
            f"{np.degrees(small.phi_i):.1f} deg",
            where="samples",
            todo=f"measure {FEWEST_IN_SCAN} or more at each azimuth; or write .nc, .csv, .astm or .ssdd",
        )
    return found


def closed(azimuths: Sequence[float]) -> tuple[Array, list[int]]:
    """Repeat azimuths of a whole or half turn so that they enclose it from -180 deg.

    Returns
    -------
    azimuths : ndarray, shape (P,)
        Increasing, in radians; renderers tell from the first and the last how much they cover.
    order : list of int
        Number of the scan of each.
    """
    gaps = np.diff([*azimuths, azimuths[0] + 2.0 * np.pi])
    period = 2.0 * np.pi if gaps.max() <= LARGEST_GAP_RAD else np.pi
    pairs = [(phi_i, number) for number, phi_i in enumerate(azimuths)]
    if pairs[0][0] > -np.pi + SAME_AZIMUTH_RAD:
        pairs.insert(0, (pairs[-1][0] - period, pairs[-1][1]))
    if pairs[-1][0] < period - np.pi - SAME_AZIMUTH_RAD:
        first = next(pair for pair in pairs if pair[0] >= -np.pi - SAME_AZIMUTH_RAD)
        pairs.append((first[0] + period, first[1]))
    return np.array([phi_i for phi_i, _ in pairs]), [number for _, number in pairs]


def _distinct(angles: Array) -> list[float]:
    """Return angles that differ, each the median of those that are the same."""
    ordered = np.sort(angles)
    steps = np.flatnonzero(np.diff(ordered) > SAME_AZIMUTH_RAD) + 1
    return [float(np.median(group)) for group in np.split(ordered, steps)] if len(ordered) else []


def _alone(given: Usable, scan: Scan) -> Usable:
    """Return a scan's samples, turned so that the light is at azimuth 0."""
    wi, wo = given.wi[scan.rows], given.wo[scan.rows]
    tilted = np.hypot(wi[:, 0], wi[:, 1]) > AT_NORMAL
    turn = np.where(tilted, -direction_to_spherical(wi)[1], -scan.phi_i)
    return Usable(turned(wi, turn), turned(wo, turn), *(column[scan.rows] for column in given[2:]))


def _field(part: Usable) -> Interpolant:
    wi, wo, f_r, own, common = part
    return Interpolant(wi, wo, f_r, u_independent=own, u_common=common, mirrored=False)


def _lookup(field: Interpolant, phi_i: float) -> Lookup:
    """Return what a scan gives for directions in the sample's frame."""

    def between(wi: Array, wo: Array) -> tuple[Array, NDArray[np.bool_]]:
        found = field(turned(wi, -phi_i), turned(wo, -phi_i))
        return found.f_r, found.hole

    return between


def _profile(fields: Sequence[Interpolant]) -> Profile:
    """Return the mean profile of all scans: between the grain's two widths."""

    def profile(radius: Array) -> Array:
        return np.asarray(np.exp(np.mean([np.log(field.trend.profile(radius)) for field in fields], axis=0)))

    return profile


def _largest_side(planes: int) -> int:
    """Return the largest size whose table is not too large, or the smallest there is."""
    fitting = [side for side in SIDES if planes * side**2 * np.dtype(np.float32).itemsize <= LARGEST_BYTES]
    return max(fitting, default=SIDES[0])
