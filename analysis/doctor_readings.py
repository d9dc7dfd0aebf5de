"""Readings of a table of angles and values: what its numbers may mean other than what is declared.

A reading is a short chain of elementary steps, each of which turns the angles or values as they were taken
into what they mean if the step is true of the file. No reading adds or drops a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical, rotation, spherical_to_direction, wrap
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from analysis.angle_table import AngleTable

Array = NDArray[np.float64]


class Step(Enum):
    """An elementary reading; the value is the name that a person types."""

    DEGREES = "degrees"
    RADIANS = "radians"
    EXCHANGED = "zenith-azimuth"
    BELOW_O = "view-inward"
    BELOW_I = "light-inward"
    RELATIVE = "specular-relative"
    ABSOLUTE = "not-specular-relative"
    SWAPPED = "light-view"
    OPPOSITE = "opposite-side"
    MIRRORED = "mirrored-azimuth"
    TURNED = "relative-azimuth"
    UNTURNED = "not-relative-azimuth"
    WITH_COS_O = "cosine-of-view"
    OVER_COS_O = "over-cosine-of-view"
    WITH_COS_I = "cosine-of-light"
    OVER_COS_I = "over-cosine-of-light"


WORDS = {
    Step.DEGREES: "the angles are degrees, read as radians",
    Step.RADIANS: "the angles are radians, read as degrees",
    Step.EXCHANGED: "zenith and azimuth are exchanged",
    Step.BELOW_O: "directions of view point into the surface",
    Step.BELOW_I: "directions of light point into the surface",
    Step.RELATIVE: "directions of view are relative to the mirror direction",
    Step.ABSOLUTE: "directions of view were taken as relative to the mirror direction and are not",
    Step.SWAPPED: "light and view are exchanged",
    Step.OPPOSITE: "view angles have the other sign: the light's side is taken for the mirror's",
    Step.MIRRORED: "the azimuth of view runs in the other sense than the light's",
    Step.TURNED: "the azimuth of view is counted from the light's azimuth",
    Step.UNTURNED: "the azimuth of view was taken as counted from the light's and is not",
    Step.WITH_COS_O: "the values hold a factor cos(theta_o)",
    Step.OVER_COS_O: "the values were divided by cos(theta_o)",
    Step.WITH_COS_I: "the values hold a factor cos(theta_i)",
    Step.OVER_COS_I: "the values were divided by cos(theta_i)",
}


COSINES = {
    Step.WITH_COS_O: (0, -1),
    Step.OVER_COS_O: (0, 1),
    Step.WITH_COS_I: (-1, 0),
    Step.OVER_COS_I: (1, 0),
}
"""Steps that change values, and the powers of cos(theta_i) and cos(theta_o) that they multiply by."""


@dataclass(frozen=True)
class Reading:
    """Steps, first to last; none is the file as declared."""

    steps: tuple[Step, ...] = ()

    @property
    def name(self) -> str:
        """What a person types to choose it."""
        return "+".join(step.value for step in self.steps) or "as-declared"

    @property
    def words(self) -> str:
        """What it says of the file."""
        return ", and ".join(WORDS[step] for step in self.steps) or "as declared"

    @property
    def turned(self) -> tuple[Step, ...]:
        """Return the steps that change directions."""
        return tuple(step for step in self.steps if step not in COSINES)

    @property
    def powers(self) -> tuple[int, int]:
        """Powers of cos(theta_i) and cos(theta_o) by which the values are multiplied."""
        light, view = (
            zip(*(COSINES.get(step, (0, 0)) for step in self.steps), strict=True) if self.steps else ((), ())
        )
        return sum(light), sum(view)

    def apply(self, table: AngleTable) -> AngleTable:
        """Return what the table means under this reading."""
        for step in self.steps:
            table = _APPLY[step](table)
        return table


def _scaled(table: AngleTable, factor: float) -> AngleTable:
    angles = (table.theta_i, table.phi_i, table.theta_o, table.phi_o)
    theta_i, phi_i, theta_o, phi_o = (factor * angle for angle in angles)
    return replace(table, theta_i=theta_i, phi_i=phi_i, theta_o=theta_o, phi_o=phi_o)


def _exchanged(table: AngleTable) -> AngleTable:
    theta_i, phi_i = _one_exchanged(table.theta_i, table.phi_i)
    theta_o, phi_o = _one_exchanged(table.theta_o, table.phi_o)
    return replace(table, theta_i=theta_i, phi_i=phi_i, theta_o=theta_o, phi_o=phi_o)


def _one_exchanged(theta: Array, phi: Array) -> tuple[Array, Array]:
    """Exchange; once a vector was made, an azimuth beyond 90 deg is a polar angle past the pole."""
    turned = np.asarray(wrap(phi))
    past = np.abs(turned) > np.pi / 2.0 + 1e-12
    return np.where(past, wrap(turned - np.pi), turned), np.where(past, -theta, theta)


def _inward(table: AngleTable, *, light: bool) -> AngleTable:
    if light:
        return replace(table, theta_i=np.pi - table.theta_i, phi_i=wrap(table.phi_i + np.pi))
    return replace(table, theta_o=np.pi - table.theta_o, phi_o=wrap(table.phi_o + np.pi))


def _tilted(table: AngleTable, sign: float) -> AngleTable:
    """Turn views by the light's polar angle within the plane of incidence: +z goes to the mirror direction.

    `sign` is +1 from relative to absolute. A relative direction on the light's side of the mirror direction
    lies towards the normal.
    """
    flat = spherical_to_direction(table.theta_o, table.phi_o - table.phi_i)
    tilt = rotation([0.0, 1.0, 0.0], -sign * table.theta_i)
    theta, phi = direction_to_spherical(np.einsum("nij,nj->ni", tilt, flat))
    return replace(table, theta_o=theta, phi_o=np.asarray(wrap(phi + table.phi_i)))


def _times(table: AngleTable, light: int, view: int) -> AngleTable:
    """Multiply values by powers of cosines, each at least that of 89.4 deg."""
    cos_i, cos_o = (np.maximum(np.abs(np.cos(t)), 0.01)[:, None] for t in (table.theta_i, table.theta_o))
    return table.scaled(cos_i**light * cos_o**view)


_APPLY: dict[Step, Callable[[AngleTable], AngleTable]] = {
    Step.DEGREES: lambda t: _scaled(t, np.pi / 180.0),
    Step.RADIANS: lambda t: _scaled(t, 180.0 / np.pi),
    Step.EXCHANGED: _exchanged,
    Step.BELOW_O: lambda t: _inward(t, light=False),
    Step.BELOW_I: lambda t: _inward(t, light=True),
    Step.RELATIVE: lambda t: _tilted(t, 1.0),
    Step.ABSOLUTE: lambda t: _tilted(t, -1.0),
    Step.SWAPPED: lambda t: replace(t, theta_i=t.theta_o, phi_i=t.phi_o, theta_o=t.theta_i, phi_o=t.phi_i),
    Step.OPPOSITE: lambda t: replace(t, phi_o=np.asarray(wrap(t.phi_o + np.pi))),
    Step.MIRRORED: lambda t: replace(t, phi_o=-t.phi_o),
    Step.TURNED: lambda t: replace(t, phi_o=np.asarray(wrap(t.phi_o + t.phi_i))),
    Step.UNTURNED: lambda t: replace(t, phi_o=np.asarray(wrap(t.phi_o - t.phi_i))),
    **{step: partial(_times, light=light, view=view) for step, (light, view) in COSINES.items()},
}

INVERSE = {
    Step.DEGREES: Step.RADIANS,
    Step.RELATIVE: Step.ABSOLUTE,
    Step.TURNED: Step.UNTURNED,
    Step.WITH_COS_O: Step.OVER_COS_O,
    Step.WITH_COS_I: Step.OVER_COS_I,
}
INVERSE |= {second: first for first, second in INVERSE.items()}
"""Steps that undo another; the rest undo themselves."""

UNITS = (Step.DEGREES, Step.RADIANS)
DIRECTIONS = (
    Step.EXCHANGED,
    Step.BELOW_O,
    Step.BELOW_I,
    Step.RELATIVE,
    Step.ABSOLUTE,
    Step.SWAPPED,
    Step.OPPOSITE,
    Step.MIRRORED,
    Step.TURNED,
    Step.UNTURNED,
)


def reading_of(name: str) -> Reading:
    """Return the reading of a name, steps joined by `+`.

    Raises
    ------
    BadInput
        If a step is unknown.
    """
    known = {step.value: step for step in Step}
    words = [] if name == Reading().name else name.split("+")
    for word in words:
        if word not in known:
            raise BadInput(f"unknown reading '{word}'", where="--reading", todo=f"known: {', '.join(known)}")
    return Reading(tuple(known[word] for word in words))


def candidates() -> list[Reading]:
    """Return every reading that is tried: none, one step, or two of different kinds."""
    single = [Reading((step,)) for step in (*UNITS, *DIRECTIONS, *COSINES)]
    double = [
        *((unit, other) for unit in UNITS for other in (*DIRECTIONS, *COSINES)),
        *((turn, cosine) for turn in DIRECTIONS for cosine in COSINES),
        *((Step.EXCHANGED, other) for other in (Step.RELATIVE, Step.OPPOSITE, Step.MIRRORED, Step.TURNED)),
        (Step.BELOW_I, Step.BELOW_O),
        (Step.MIRRORED, Step.OPPOSITE),
        (Step.OPPOSITE, Step.RELATIVE),
    ]
    return [Reading(), *single, *(Reading(pair) for pair in double)]
