"""What is lit: one sample under a small lamp, what surrounds it, as data that every method reads.

Millimetres and radians in the frame of the sample: its centre is the origin, its normal is +z. The lamp is a
disc of `rig.lamp.diameter_mm` that faces the sample's centre; its intensity is `lamp_intensity`, so that the
irradiance there at normal incidence is 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.errors import BadInput
from simulator.mounting import PLAIN

if TYPE_CHECKING:
    from rig.description import Rig
    from simulator.materials import Material

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

HOUSING_HALF_SIZE = 1.5
"""Half the side of the housing's cube, in units of the longer of the lamp's and the camera's distance."""


class Event(StrEnum):
    """A scattering event, by its letter in `simulator.light.paths`."""

    LAMBERTIAN = "Dl"
    GLOSSY = "Dg"
    MIRROR = "S"


@dataclass(frozen=True)
class Housing:
    """A cube around everything, its middle at the origin, Lambertian and grey inside.

    Parameters
    ----------
    albedo : float
        Above 0, below 1.
    half_size_mm : float
        Half its side.

    Raises
    ------
    BadInput
        An albedo that no housing has.
    """

    albedo: float
    half_size_mm: float

    def __post_init__(self) -> None:
        if not 0.0 < self.albedo < 1.0:
            what = f"a housing of albedo {self.albedo:g}"
            raise BadInput(what, where="housing", todo="give an albedo above 0 and below 1")


@dataclass(frozen=True)
class PlanarMirror:
    """A rectangle that mirrors on one side and blocks nothing else that matters.

    Parameters
    ----------
    centre_mm : tuple of float
        Its middle.
    across_mm, up_mm : tuple of float
        Half its sides, at right angles; across x up is the normal of the side that mirrors.
    reflectance : float
        Between 0 and 1.

    Raises
    ------
    BadInput
        Sides of no length or not at right angles, or a reflectance that no mirror has.
    """

    centre_mm: Vector
    across_mm: Vector
    up_mm: Vector
    reflectance: float = 1.0

    def __post_init__(self) -> None:
        across, up = np.asarray(self.across_mm), np.asarray(self.up_mm)
        lengths = np.linalg.norm(across) * np.linalg.norm(up)
        if not lengths > 0.0 or abs(across @ up) > 1e-9 * lengths:
            raise BadInput(
                "a mirror's sides are not at right angles", where="mirror", todo="give two half sides"
            )
        if not 0.0 < self.reflectance <= 1.0:
            what = f"a mirror of reflectance {self.reflectance:g}"
            raise BadInput(what, where="mirror", todo="give one above 0, up to 1")

    @cached_property
    def normal(self) -> Array:
        """Unit normal of the side that mirrors, shape (3,)."""
        return unit(np.cross(self.across_mm, self.up_mm))

    @cached_property
    def corners_mm(self) -> Array:
        """Corners in order around it, shape (4, 3)."""
        centre, across, up = (np.asarray(v) for v in (self.centre_mm, self.across_mm, self.up_mm))
        return np.asarray(centre + np.array([across + up, up - across, -across - up, across - up]))

    def image(self, points_mm: Array) -> Array:
        """Return where points (..., 3) appear in it."""
        height = (points_mm - np.asarray(self.centre_mm)) @ self.normal
        return np.asarray(points_mm - 2.0 * height[..., None] * self.normal)


@dataclass(frozen=True, eq=False)
class Scene:
    """One sample, lit.

    Parameters
    ----------
    rig : Rig
        Lamp, camera, sample size, and how poses move them.
    material : Material
        What the sample is made of, and how it is made and mounted.
    events : frozenset of Event
        What the sample can do to light: empty for black; `mitsuba_scene.sample_events` finds it.
    housing : Housing, optional
        By default the surroundings are black.
    mirrors : tuple of PlanarMirror
        They do not move with any joint.
    lamp_cosine : bool
        Whether the lamp shines as a flat disc does, with the cosine of the angle from its axis, and not
        backwards; otherwise it shines evenly in all directions.
    """

    rig: Rig
    material: Material
    events: frozenset[Event]
    housing: Housing | None = None
    mirrors: tuple[PlanarMirror, ...] = ()
    lamp_cosine: bool = True

    @property
    def plain(self) -> bool:
        """Whether the sample is flat, level and alike everywhere."""
        return self.material.mounting == PLAIN

    @property
    def rendered(self) -> bool:
        """Whether Mitsuba can be given all that the sample is made of."""
        pattern = self.material.mounting.pattern
        return self.material.rendered and (pattern is None or pattern.other.rendered)

    @property
    def lamp_intensity(self) -> float:
        """Radiant intensity towards the sample at level 1, in mm^2 times the unit of irradiance."""
        return self.rig.lamp.distance_mm**2

    @property
    def lamp_radius_mm(self) -> float:
        """Radius of the lamp's disc."""
        return self.rig.lamp.diameter_mm / 2.0

    @property
    def sample_radius_mm(self) -> float:
        """Radius of the sample's disc."""
        return self.rig.sample.diameter_mm / 2.0


def default_housing(rig: Rig, albedo: float) -> Housing | None:
    """Return the housing of an albedo that leaves room for both arms; None for albedo 0."""
    if albedo == 0.0:
        return None
    return Housing(albedo, HOUSING_HALF_SIZE * max(rig.lamp.distance_mm, rig.camera.distance_mm))
