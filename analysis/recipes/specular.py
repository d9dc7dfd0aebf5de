"""Steps in the plane around the mirror direction: the peak brought into the plane of incidence, and a grid.

A view direction is placed at its angle from the mirror direction (radial) and its azimuth around it, counted
from the direction that leads to the normal: the coordinates of Zemax's files.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from analysis.formats.zemax import HORIZON, directions
from analysis.recipes.natural import natural_weights
from analysis.recipes.readings import PER_READING, SAME_ANGLE_RAD, Flag, Readings, identities
from analysis.recipes.steps import Given, Step
from analysis.uncertainty import quadrature
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]

AzimuthDeg = Annotated[float, Field(ge=0, le=180)]
RadialDeg = Annotated[float, Field(ge=0, le=180)]

PEAK_EVERY_RAD = np.pi / 18
"""Spacing in azimuth of the copies of the peak along the line that the mirror direction becomes."""


class AlignPeak(Step):
    """Find how far the peak lies beside the plane of incidence, and take it out of the directions.

    In each file and incidence the largest usable reading is the peak; the mean of their sideways distances
    (radial angle times the sine of its azimuth) is one error of the instrument's alignment for all of them.
    Its uncertainty is that of the mean: of the distances' scatter, or of a peak that lies anywhere between
    its neighbours on the grid (rectangular), whichever is larger. Readings that are averaged keep to their
    nominal angles; directions are shifted where they are interpolated, in `specular_grid`.
    """

    name: Literal["align_peak"]

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002 - every step has both
        """Find it."""
        sideways, along = around_mirror(readings)
        level = np.where(readings.usable, readings.value, -np.inf).mean(axis=1)
        _, group = identities(readings.theta_i, readings.file.astype(np.float64))
        found, steps = [], []
        for one in range(int(group.max()) + 1):
            rows = np.flatnonzero(group == one)
            peak = rows[int(np.argmax(level[rows]))]
            if np.isfinite(level[peak]):
                found.append(float(sideways[peak]))
                away = np.hypot(sideways[rows] - sideways[peak], along[rows] - along[peak])
                steps.append(float(np.min(away[away > SAME_ANGLE_RAD], initial=np.pi)))
        if not found:
            raise BadInput("finds no usable reading", where="recipe, step align_peak", todo="check the cuts")
        mean = float(np.mean(found))
        scatter = float(np.std(found, ddof=1)) if len(found) > 1 else 0.0
        u_mean = max(scatter, float(np.mean(steps)) / np.sqrt(12.0)) / np.sqrt(len(found))
        return replace(readings, sideways_rad=mean, u_sideways_rad=u_mean).noted(
            f"align_peak: the peak lies {np.degrees(mean):.2f} deg beside the plane of incidence "
            f"(standard uncertainty {np.degrees(u_mean):.2f} deg, from {len(found)} peaks)"
        )


class SpecularGrid(Step):
    """Interpolate an isotropic sample's readings onto a grid around the mirror direction.

    Natural neighbours (Sibson 1981) in the plane of azimuth and radial angle, both sides of the plane of
    incidence folded into one and mirrored. The mirror direction becomes a line of that plane: it gets the
    largest reading of its incidence, as published chains have it. Cells beyond the readings are flagged,
    cells below the horizon left out. Errors of readings go through the interpolation's weights, the peak's
    alignment through the change of the cell.
    """

    name: Literal["specular_grid"]
    azimuth_deg: tuple[AzimuthDeg, ...] = Field(min_length=1, description="0 to 180 degrees each")
    radial_deg: tuple[RadialDeg, ...] = Field(min_length=1, description="0 to 180 degrees each")

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Interpolate each incidence by itself."""
        azimuth, radial = np.meshgrid(
            np.radians(self.azimuth_deg), np.radians(self.radial_deg), indexing="ij"
        )
        # The mirror direction is one cell, however many azimuths have it.
        once = (radial > SAME_ANGLE_RAD) | (np.arange(len(azimuth))[:, None] == 0)
        cells = np.stack([azimuth[once], radial[once]], axis=-1)
        if readings.value.shape[1] != 1:
            raise BadInput(
                f"takes one channel, here are {readings.value.shape[1]}",
                where="recipe, step specular_grid",
                todo="reduce one channel",
            )
        _, group = identities(readings.theta_i)
        parts = [_gridded(readings.rows(group == one), cells) for one in range(int(group.max()) + 1)]
        whole = parts[0].with_columns(
            {name: np.concatenate([getattr(part, name) for part in parts]) for name in PER_READING}
        )
        every = np.arange(len(whole))
        return replace(whole, origin=every, blank_id=every)


def around_mirror(readings: Readings) -> tuple[Array, Array]:
    """Place view directions in the plane around the mirror direction.

    Returns
    -------
    sideways, along : ndarray, shape (N,)
        Radial angle times the sine and the cosine of the azimuth, in radians; along is positive towards the
        normal.
    """
    x, y, z = np.moveaxis(spherical_to_direction(readings.theta_o, readings.between), -1, 0)
    sin_i, cos_i = np.sin(readings.theta_i), np.cos(readings.theta_i)
    local = np.stack([cos_i * x + sin_i * z, y, cos_i * z - sin_i * x], axis=-1)
    radial, azimuth = direction_to_spherical(local)
    return radial * np.sin(azimuth), radial * np.cos(azimuth)


def _gridded(readings: Readings, cells: Array) -> Readings:
    """Interpolate one incidence; cells are (azimuth, radial), shape (M, 2)."""
    theta_i = float(readings.theta_i[0])
    wo = directions(np.asarray(theta_i), *cells.T)
    above = wo[:, 2] > HORIZON
    wo, cells = wo[above], cells[above]
    used = readings.rows(readings.usable[:, 0])
    if not len(used):
        raise BadInput(
            f"has no usable reading at incidence {np.degrees(theta_i):g} deg",
            where="recipe, step specular_grid",
            todo="check the cuts, or leave that incidence out",
        )
    weights = _weights(used, readings.sideways_rad, cells)
    count = len(cells)
    theta_o, phi_o = direction_to_spherical(wo)
    outside = np.asarray(weights.sum(axis=1)).ravel() == 0.0
    value = np.where(outside[:, None], np.nan, weights @ used.value)
    moved = sum(
        sign * (_weights(used, readings.sideways_rad + sign * readings.u_sideways_rad, cells) @ used.value)
        for sign in (-1.0, 1.0)
    ) if readings.u_sideways_rad > 0.0 else np.zeros((count, 1))  # fmt: skip
    return replace(
        readings,
        theta_i=np.full(count, theta_i),
        phi_i=np.zeros(count),
        theta_o=theta_o,
        phi_o=phi_o,
        value=value,
        flags=np.where(outside, int(Flag.NOT_MEASURED), 0)[:, None],
        u_noise=_through(weights, used.origin, used.u_noise),
        u_blank=_through(weights, used.blank_id, used.u_blank),
        u_common=quadrature(weights @ used.u_common, 0.5 * np.abs(moved)),
        origin=np.arange(count),
        blank_id=np.arange(count),
        file=np.zeros(count, dtype=np.int64),
    )


def _weights(readings: Readings, sideways_rad: float, cells: Array) -> csr_array:
    """Weight of each reading in each cell, shape (M, N)."""
    from scipy.sparse import csr_array

    sideways, along = around_mirror(readings)
    sideways = sideways - sideways_rad
    azimuth, radial = np.abs(np.arctan2(sideways, along)), np.hypot(sideways, along)
    # The mirror image continues the plane beyond azimuth 0 and pi, for half a turn in all.
    image = np.where(azimuth < np.pi / 2, -azimuth, 2.0 * np.pi - azimuth)
    line = np.arange(-np.pi / 2, 1.5 * np.pi + SAME_ANGLE_RAD, PEAK_EVERY_RAD)
    points = np.stack(
        [
            np.concatenate([azimuth, image, line]),
            np.concatenate([radial, radial, np.zeros_like(line)]),
        ],
        axis=-1,
    )
    count = len(readings)
    peak = int(np.argmax(readings.value[:, 0]))
    source = np.concatenate([np.arange(count), np.arange(count), np.full(len(line), peak)])
    back = csr_array((np.ones(len(points)), (np.arange(len(points)), source)), shape=(len(points), count))
    return csr_array(natural_weights(points, cells) @ back)


def _through(weights: csr_array, cause: NDArray[np.int64], column: Array) -> Array:
    """Take errors through weights: what has one cause adds linearly, different causes in quadrature."""
    from scipy.sparse import csr_array

    _, number = np.unique(cause, return_inverse=True)
    sources = csr_array(
        (column[:, 0], (np.arange(len(number)), number.ravel())),
        shape=(len(number), int(number.max()) + 1),
    )
    through = csr_array(weights @ sources)
    return np.asarray(np.sqrt(through.multiply(through).sum(axis=1))).reshape(-1, 1)
