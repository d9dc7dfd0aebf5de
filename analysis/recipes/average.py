"""Steps that make one reading of several: repeats, mirrored azimuths, the pole, both sides of a plane."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from analysis.recipes.readings import ANGLES, SAME_ANGLE_RAD, Flag, Readings, identities, with_floor
from analysis.recipes.repeatability import Repeatability, repeatability
from analysis.recipes.steps import Given, Step

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Average(Step):
    """Average the readings of one place: those of several files and, if asked, of mirrored azimuths.

    Independent errors fall with the root of the number; what readings share (a blank's reading, the
    reference) does not. Where several files are averaged, their repeatability is found, and the stated
    uncertainty of the average is at least what it is for so many files. Where both sides of the plane of
    incidence are averaged, it is at least what their difference allows in the same way: tilt, anisotropy.
    """

    name: Literal["average"]
    mirror: bool = Field(
        False, description="true: azimuths on both sides of the plane of incidence are one place (isotropic)"
    )
    repeatability_floor: bool = Field(
        True, description="false: leave the stated uncertainty as it is, even below the spread of the files"
    )

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Average, and keep one reading of each place."""
        place = _places(readings, mirror=self.mirror)
        cells = _averaged(readings, place, np.ones(readings.value.shape))
        found = _between(readings, place, readings.file)
        sides = (readings.between < 0.0).astype(np.int64)
        causes = [(readings.file, found)]
        causes += [(sides, _between(readings, place, sides))] if self.mirror else []
        for number, spread in causes:
            if spread is not None and self.repeatability_floor:
                cells = with_floor(cells, spread.standard_deviation, _counted(readings, place, number))
        if self.mirror:
            kept = _first_azimuths(readings, place)
            angles = {name: getattr(readings, name)[kept] for name in ANGLES}
            cells = cells.rows(place[kept]).with_columns(angles)
        return replace(cells, repeatability=found)


class PoleAverage(Step):
    """Make one reading of all that look along the normal, weighted by the azimuth that each stands for.

    In the plane of incidence and across it a reading stands for half as much as any other, because a table of
    the full circle has its mirror image too.
    """

    name: Literal["pole_average"]

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Average them."""
        at_pole = readings.theta_o < SAME_ANGLE_RAD
        line = _off_plane(readings)
        _, place = identities(
            readings.theta_i,
            np.where(at_pole, 0.0, readings.phi_i),
            readings.theta_o,
            np.where(at_pole, 0.0, readings.phi_o),
        )
        edge = (line < SAME_ANGLE_RAD) | (line > np.pi / 2 - SAME_ANGLE_RAD)
        _, twin = identities(readings.theta_i, np.where(at_pole, line, readings.phi_i), place.astype(float))
        alike = np.bincount(twin)[twin]
        weight = np.where(at_pole & ~edge, 2.0, 1.0) / np.where(at_pole, alike, 1)
        return _averaged(readings, place, np.broadcast_to(weight[:, None], readings.value.shape))


class Sides(Step):
    """Write an isotropic sample's readings on one side of the plane of incidence, or on both.

    The light then stands at azimuth 180 degrees, so that azimuth 0 leads to the mirror direction.
    """

    name: Literal["sides"]
    count: Literal[1, 2] = Field(1, description="1: azimuths 0 to 180 degrees; 2: the full circle")

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Fold, or fold and mirror."""
        pole = readings.theta_o < SAME_ANGLE_RAD
        side = np.where(pole, np.pi, np.abs(readings.between))
        _, place = identities(readings.theta_i, readings.theta_o, side)
        cells = _averaged(readings, place, np.ones(readings.value.shape))
        folded = np.pi - side[np.unique(place, return_index=True)[1]]
        one = replace(cells, phi_i=np.full(len(cells), np.pi), phi_o=folded)
        if self.count == 1:
            return one
        other = (one.phi_o > SAME_ANGLE_RAD) & (one.phi_o < np.pi - SAME_ANGLE_RAD)
        index = np.concatenate([np.arange(len(one)), np.flatnonzero(other)])
        sign = np.concatenate([np.ones(len(one)), -np.ones(int(other.sum()))])
        both = one.rows(index)
        return replace(both, phi_o=both.phi_o * sign)


def _places(readings: Readings, *, mirror: bool) -> Indices:
    """Give each reading the number of the place that it is averaged at."""
    if not mirror:
        return identities(readings.theta_i, readings.phi_i, readings.theta_o, readings.phi_o)[1]
    # At the pole only the plane of view is told, not its direction.
    pole = readings.theta_o < SAME_ANGLE_RAD
    side = np.where(pole, _off_plane(readings), np.abs(readings.between))
    return identities(readings.theta_i, readings.theta_o, side)[1]


def _off_plane(readings: Readings) -> Array:
    """Angle between the plane of view and the plane of incidence, 0 to pi/2."""
    side = np.abs(readings.between)
    return np.asarray(np.minimum(side, np.pi - side))


def _first_azimuths(readings: Readings, place: Indices) -> Indices:
    """Rows of each place that have its smallest azimuth of the light, one of each nominal direction."""
    smallest = np.full(int(place.max()) + 1, np.inf)
    np.minimum.at(smallest, place, readings.phi_i)
    chosen = np.flatnonzero(readings.phi_i <= smallest[place] + SAME_ANGLE_RAD)
    some = readings.rows(chosen)
    return np.asarray(chosen[identities(some.theta_i, some.phi_i, some.theta_o, some.phi_o)[0]])


def _averaged(readings: Readings, place: Indices, weight: Array) -> Readings:
    """Average the usable readings of each place, weighted; one row a place, with its first reading's angles.

    A place without usable readings keeps its flags and is NaN.
    """
    weight = np.where(readings.usable, weight, 0.0)
    count = int(place.max()) + 1
    total = _summed(weight, place, count)
    share = weight / np.where(total == 0.0, 1.0, total)[place]
    value = _summed(share * np.where(weight > 0.0, readings.value, 0.0), place, count)
    empty = total == 0.0
    reasons = np.zeros(total.shape, dtype=np.int64)
    np.bitwise_or.at(reasons, place, readings.flags)
    part = {
        name: np.where(weight > 0.0, getattr(readings, name), 0.0)
        for name in ("u_noise", "u_blank", "u_common")
    }
    first = np.unique(place, return_index=True)[1]
    return replace(
        readings.rows(first),
        value=np.where(empty, np.nan, value),
        flags=np.where(empty, np.where(reasons == 0, int(Flag.NOT_MEASURED), reasons), 0),
        u_noise=_of_shared(readings.origin, place, share * part["u_noise"], count),
        u_blank=_of_shared(readings.blank_id, place, share * part["u_blank"], count),
        u_common=_summed(share * part["u_common"], place, count),
        origin=np.arange(count),
        blank_id=np.arange(count),
        file=np.zeros(count, dtype=np.int64),
    )


def _of_shared(cause: Indices, place: Indices, column: Array, count: int) -> Array:
    """Add what has one cause linearly, and different causes in quadrature."""
    _, first, pair = np.unique(
        np.stack([place, cause], axis=-1), axis=0, return_index=True, return_inverse=True
    )
    within = _summed(column, pair.ravel(), len(first))
    return np.asarray(np.sqrt(_summed(np.square(within), place[first], count)))


def _summed(values: Array, index: Indices, count: int) -> Array:
    total = np.zeros((count, values.shape[1]))
    np.add.at(total, index, values)
    return total


def _counted(readings: Readings, place: Indices, of: Indices) -> Array:
    """Return how many files, or sides, have a usable reading of each place, shape (places, C)."""
    counts = np.zeros((int(place.max()) + 1, readings.value.shape[1]))
    for number in np.unique(of):
        used = readings.usable & (of == number)[:, None]
        counts += _summed(used.astype(np.float64), place, len(counts)) > 0.0
    return counts


def _between(readings: Readings, place: Indices, of: Indices) -> Repeatability | None:
    """Compare the means that files, or sides, have of each place, over all channels."""
    numbers = np.unique(of)
    if len(numbers) < 2:
        return None
    count = int(place.max()) + 1
    theta_o = np.zeros(count)
    theta_o[place] = readings.theta_o
    table = np.full((len(numbers), count, readings.value.shape[1]), np.nan)
    for index, number in enumerate(numbers):
        chosen = of == number
        rows = readings.rows(chosen)
        weight = rows.usable.astype(float)
        total = _summed(weight, place[chosen], count)
        value = _summed(np.where(weight > 0.0, rows.value, 0.0), place[chosen], count)
        table[index] = np.where(total > 0.0, value / np.where(total > 0.0, total, 1.0), np.nan)
    channels = table.shape[2]
    return repeatability(table.reshape(len(numbers), -1), np.repeat(theta_o, channels))
