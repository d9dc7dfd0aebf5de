"""The steps that act on each reading for itself: blank, floor, shadow, reference, cosine, cuts.

A step is a name and parameters, as a recipe's file writes them, and a pure function from readings to readings
that also carries their uncertainties.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from analysis.recipes.readings import ANGLES, SAME_ANGLE_RAD, Flag, Readings, identities, with_floor
from analysis.uncertainty import quadrature
from rig.errors import BadInput
from rig.parts import Part

Array = NDArray[np.float64]

SHOWN_DEG = 1e-6
"""Slack for angles that a recipe names in degrees, so that its limits include what stands on them."""


@dataclass(frozen=True)
class Given:
    """What a recipe gets beside the readings.

    Attributes
    ----------
    blank : Readings, optional
        The measurement without a sample.
    """

    blank: Readings | None = None


class Step(Part):
    """Base of the steps."""

    def apply(self, readings: Readings, given: Given) -> Readings:
        """Return the readings after this step.

        Raises
        ------
        BadInput
            If the step cannot be done with what is given.
        """
        raise NotImplementedError


class Blank(Step):
    """Subtract the measurement without a sample, reading by reading at the same nominal angles.

    The blank's own noise is told from how it differs from a straight line between its neighbours in receive
    angle (Gasser, Sroka & Jennen-Steinmetz 1986); the detector being the same, each reading of the sample has
    at least that. Readings that share a reading of the blank share its error.
    """

    name: Literal["blank"]

    def apply(self, readings: Readings, given: Given) -> Readings:
        """Subtract it."""
        blank = given.blank
        if blank is None:
            raise BadInput(
                "needs the measurement without a sample, and none is given",
                where="recipe, step blank",
                todo="give --blank FILE, or take the step out of a copy of the recipe",
            )
        if blank.value.shape[1] != readings.value.shape[1]:
            raise BadInput(
                f"has {blank.value.shape[1]} channels, the sample {readings.value.shape[1]}",
                where=blank.files[0],
                todo="choose the blank of the same instrument and channels",
            )
        at = _at_the_same_angles(readings, blank)
        noise = difference_noise(blank)
        return replace(
            readings,
            value=readings.value - blank.value[at],
            flags=readings.flags | blank.flags[at],
            u_noise=quadrature(readings.u_noise, noise),
            u_blank=quadrature(blank.u_noise[at], noise),
            u_common=quadrature(readings.u_common, blank.u_common[at]),
            blank_id=at,
        )


class FloorShift(Step):
    """Shift each file's smallest value to zero. Legacy: some published tables did; it raises dark samples.

    The shift is an error of unknown size between nothing and all of it, common to all readings: standard
    uncertainty shift / sqrt(3) (JCGM 100:2008, 4.3.7).
    """

    name: Literal["floor_shift"]

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002 - every step has both
        """Shift, and say so."""
        shift = np.zeros(readings.value.shape)
        finite = np.where(np.isfinite(readings.value), readings.value, np.inf)
        for number in np.unique(readings.file):
            of_file = readings.file == number
            lowest = finite[of_file].min(axis=0)
            shift[of_file] = np.where(np.isfinite(lowest), -lowest, 0.0)
        largest = float(np.max(np.abs(shift)))
        return replace(
            readings,
            value=readings.value + shift,
            u_common=quadrature(readings.u_common, shift / np.sqrt(3.0)),
        ).noted(
            f"floor_shift moved all readings, by up to {largest:.3g}: for comparison with tables published "
            "that way, not for new results"
        )


class ShadowCut(Step):
    """Flag readings whose detector stands in the light's beam, or so near that its arm shadows the beam."""

    name: Literal["shadow_cut"]
    polar_deg: float = Field(gt=0, le=90, description="reach along the polar angle, above 0 to 90 degrees")
    azimuth_deg: float = Field(
        gt=0, le=90, description="reach off the plane of incidence, above 0 to 90 degrees"
    )

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Flag them."""
        # The detector's angle in its own plane, positive on the light's side; at the pole it is on both.
        off_plane = np.minimum(np.abs(readings.between), np.pi - np.abs(readings.between))
        signed = np.where(np.abs(readings.between) <= np.pi / 2, readings.theta_o, -readings.theta_o)
        slack = np.radians(SHOWN_DEG)
        near = (off_plane <= np.radians(self.azimuth_deg) + slack) & (
            np.abs(signed - readings.theta_i) <= np.radians(self.polar_deg) + slack
        )
        flag = np.where(near, int(Flag.SELF_SHADOW), 0)[:, None]
        return replace(readings, flags=readings.flags | flag)


class Reference(Step):
    """Multiply ratios to a diffuser by its reflectance over pi."""

    name: Literal["reference"]
    reflectance: float = Field(1.0, gt=0, le=2, description="of the reference, above 0 to 2")
    u_reflectance: float = Field(
        0.0, ge=0, le=1, description="its standard uncertainty (k = 1), 0 to 1, as its certificate has it"
    )

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Multiply; the certificate's error is common to all readings."""
        scaled = readings.scaled(self.reflectance / np.pi)
        own = np.abs(scaled.value) * (self.u_reflectance / self.reflectance)
        return replace(scaled, u_common=quadrature(scaled.u_common, own))


class Scale(Step):
    """Multiply by a number: for an irradiance, a solid angle, a unit."""

    name: Literal["scale"]
    factor: float = Field(gt=0, description="above 0")
    relative_u: float = Field(0.0, ge=0, le=1, description="its relative standard uncertainty, 0 to 1")

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Multiply; the factor's error is common to all readings."""
        scaled = readings.scaled(self.factor)
        return replace(scaled, u_common=quadrature(scaled.u_common, np.abs(scaled.value) * self.relative_u))


class Cosine(Step):
    """Divide by the cosine of the view or light angle, or multiply, where a published formula does."""

    name: Literal["cosine"]
    of: Literal["view", "light"] = Field("view", description='"view" or "light"')
    operation: Literal["divide", "multiply"] = Field("divide", description='"divide" or "multiply"')
    u_angle_deg: float = Field(
        0.0, ge=0, le=10, description="standard uncertainty of the angle, 0 to 10 degrees"
    )

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Do it; an angle's error costs tan(theta) of it, for each reading by itself."""
        theta = readings.theta_o if self.of == "view" else readings.theta_i
        grazing = np.cos(theta) <= SAME_ANGLE_RAD
        cosine = np.where(grazing, np.nan, np.cos(theta))
        factor = cosine if self.operation == "multiply" else 1.0 / cosine
        scaled = readings.scaled(factor[:, None])
        relative = np.where(grazing, np.nan, np.tan(theta)) * np.radians(self.u_angle_deg)
        return replace(
            scaled, u_noise=quadrature(scaled.u_noise, np.abs(scaled.value) * np.abs(relative)[:, None])
        )


class KnownRepeatability(Step):
    """Where no files of one sample were compared, state at least the repeatability known of the instrument.

    Standard deviation of one file's reading: root of additive^2 + (relative x reading)^2, each reading by
    itself. Mount, alignment and lamp change from file to file, and no noise within one file shows that.
    """

    name: Literal["repeatability"]
    relative: float = Field(ge=0, le=1, description="part in proportion to the reading, 0 to 1")
    additive: float = Field(0.0, ge=0, description="part that does not depend on it, in the reading's unit")

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Raise what is stated to that, but where `average` found the files' own."""
        if readings.repeatability is not None:
            return readings
        return with_floor(readings, lambda level: np.hypot(self.additive, self.relative * level), 1.0)


class AngleCut(Step):
    """Flag what is seen or lit from beyond an angle."""

    name: Literal["angle_cut"]
    view_deg: float = Field(90.0, gt=0, le=90, description="largest view angle kept, above 0 to 90 degrees")
    light_deg: float = Field(90.0, gt=0, le=90, description="largest light angle kept, above 0 to 90 degrees")

    def apply(self, readings: Readings, given: Given) -> Readings:  # noqa: ARG002
        """Flag them."""
        slack = np.radians(SHOWN_DEG)
        beyond = (readings.theta_o > np.radians(self.view_deg) + slack) | (
            readings.theta_i > np.radians(self.light_deg) + slack
        )
        return replace(readings, flags=readings.flags | np.where(beyond, int(Flag.GRAZING), 0)[:, None])


def difference_noise(readings: Readings) -> Array:
    """Estimate the noise of smooth readings from their second differences, shape (C,).

    For each reading between two neighbours of the same light and plane of view: its distance from the line
    through both, squared, over 1 + a^2 + b^2 with the weights a, b of that line; the mean over all (Gasser,
    Sroka & Jennen-Steinmetz 1986, eq. 4). What is not smooth counts as noise. 0 where no three are in line.
    """
    line = np.mod(readings.phi_o, np.pi)
    line = np.where(np.pi - line < SAME_ANGLE_RAD, 0.0, line)
    _, group = identities(readings.theta_i, readings.phi_i, line, readings.file.astype(np.float64))
    signed = (
        np.where(np.mod(readings.phi_o, 2.0 * np.pi) < np.pi - SAME_ANGLE_RAD, 1.0, -1.0) * readings.theta_o
    )
    order = np.lexsort((signed, group))
    where, value, group = signed[order], readings.value[order], group[order]
    left, middle, right = slice(None, -2), slice(1, -1), slice(2, None)
    width = where[right] - where[left]
    whole = (
        (group[left] == group[right])
        & (width > SAME_ANGLE_RAD)
        & np.isfinite(value[left] + value[middle] + value[right]).all(axis=-1)
    )
    if not whole.any():
        return np.zeros(value.shape[1])
    a = ((where[right] - where[middle]) / np.where(whole, width, 1.0))[whole, None]
    b = 1.0 - a
    residual = a * value[left][whole] + b * value[right][whole] - value[middle][whole]
    return np.asarray(np.sqrt(np.mean(residual**2 / (1.0 + a**2 + b**2), axis=0)))


def _at_the_same_angles(sample: Readings, blank: Readings) -> NDArray[np.int64]:
    """Return the row of the blank at each of the sample's nominal angles."""
    angles = [np.concatenate([getattr(blank, name), getattr(sample, name)]) for name in ANGLES]
    first, number = identities(*angles)
    at = first[number[len(blank) :]]
    missing = np.flatnonzero(at >= len(blank))
    if missing.size:
        lost = [float(np.degrees(getattr(sample, name)[missing[0]])) for name in ANGLES]
        place = ", ".join(f"{word} {angle:g}" for word, angle in zip(ANGLES.values(), lost, strict=True))
        file = sample.files[int(sample.file[missing[0]])]
        raise BadInput(
            f"lacks {missing.size} of the {len(sample)} angles of {file}, first {place} deg",
            where=blank.files[0],
            todo="choose the blank that was taken on the same grid",
        )
    return np.asarray(at, dtype=np.int64)
