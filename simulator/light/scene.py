"""What is lit: one sample under a small lamp, what surrounds it, as data that every method reads.

Millimetres and radians in the frame of the sample: its centre is the origin, its normal is +z. The lamp is a
disc of `rig.lamp.diameter_mm` that faces the sample's centre; its intensity is `lamp_intensity`, so that the
irradiance there at normal incidence is 1.
"""

from __future__ import annotations

import math
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
    from rig import surroundings
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

    @property
    def area_mm2(self) -> float:
        """Area of its bright side."""
        return 4.0 * float(np.linalg.norm(self.across_mm) * np.linalg.norm(self.up_mm))

    def image(self, points_mm: Array) -> Array:
        """Return where points (..., 3) appear in it."""
        height = (points_mm - np.asarray(self.centre_mm)) @ self.normal
        return np.asarray(points_mm - 2.0 * height[..., None] * self.normal)

    def at(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Carry the unit square to it, areas kept.

        Parameters
        ----------
        u, v : ndarray, shape (N,)
            Between 0 and 1.

        Returns
        -------
        points_mm, normals : ndarray, shape (N, 3)
        """
        sides = np.stack([2.0 * u - 1.0, 2.0 * v - 1.0], axis=-1) @ np.array([self.across_mm, self.up_mm])
        return np.asarray(self.centre_mm) + sides, np.broadcast_to(self.normal, sides.shape)


@dataclass(frozen=True)
class SphericalMirror:
    """A round part of a sphere that mirrors on one side.

    Parameters
    ----------
    vertex_mm : tuple of float
        Its middle.
    facing : tuple of float
        Normal there of the side that mirrors, of any length but zero.
    radius_mm : float
        Of the sphere: above 0 for a hollow mirror, whose centre lies before it, below 0 for a ball.
    rim_mm : float
        Radius of its rim, up to that of the sphere.
    reflectance : float
        Between 0 and 1.

    Raises
    ------
    BadInput
        No direction, no curvature, a rim that its sphere does not have, or a reflectance that no mirror has.
    """

    vertex_mm: Vector
    facing: Vector
    radius_mm: float
    rim_mm: float
    reflectance: float = 1.0

    def __post_init__(self) -> None:
        if not np.linalg.norm(self.facing) > 0.0:
            raise BadInput(
                "a mirror that faces nowhere", where="mirror", todo="give the normal of its middle"
            )
        if not (np.isfinite(self.radius_mm) and 0.0 < self.rim_mm <= abs(self.radius_mm)):
            what = f"a mirror's rim of radius {self.rim_mm:g} mm on a sphere of {self.radius_mm:g} mm"
            raise BadInput(what, where="mirror", todo="give a rim above 0, up to the radius of the sphere")
        if not 0.0 < self.reflectance <= 1.0:
            what = f"a mirror of reflectance {self.reflectance:g}"
            raise BadInput(what, where="mirror", todo="give one above 0, up to 1")

    @cached_property
    def normal(self) -> Array:
        """Unit normal of its middle, shape (3,)."""
        return unit(np.asarray(self.facing, dtype=np.float64))

    @property
    def hollow(self) -> bool:
        """Whether it can show itself to itself."""
        return self.radius_mm > 0.0

    @property
    def centre_mm(self) -> Array:
        """Middle of the sphere, shape (3,)."""
        return np.asarray(np.asarray(self.vertex_mm) + self.radius_mm * self.normal)

    @property
    def depth_mm(self) -> float:
        """Height of the cap."""
        radius = abs(self.radius_mm)
        # Not a difference of large numbers.
        return self.rim_mm**2 / (radius + math.sqrt(radius**2 - self.rim_mm**2))

    @property
    def area_mm2(self) -> float:
        """Area of its bright side."""
        return float(2.0 * np.pi * abs(self.radius_mm) * self.depth_mm)

    def at(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Carry the unit square to it, areas kept; u = 0 is the middle. See `PlanarMirror.at`."""
        radius = abs(self.radius_mm)
        depth = u * self.depth_mm
        across = np.sqrt(depth * (2.0 * radius - depth))
        turn = 2.0 * np.pi * v
        first = unit(np.cross(np.eye(3)[np.argmin(np.abs(self.normal))], self.normal))
        second = np.cross(self.normal, first)
        ring = (across * np.cos(turn))[:, None] * first + (across * np.sin(turn))[:, None] * second
        # A hollow mirror's rim comes forward, a ball's falls back.
        points = np.asarray(self.vertex_mm) + ring + np.sign(self.radius_mm) * depth[:, None] * self.normal
        return points, self.normals_at(points)

    def normals_at(self, points_mm: Array) -> Array:
        """Return unit normals (N, 3) of the bright side at points of it, or near it."""
        return np.asarray(unit((self.centre_mm - points_mm) * np.sign(self.radius_mm)))


Mirror = PlanarMirror | SphericalMirror


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
    mirrors : tuple of PlanarMirror or SphericalMirror
        They do not move with any joint.
    lamp_cosine : bool
        Whether the lamp shines as a flat disc does, with the cosine of the angle from its axis, and not
        backwards; otherwise it shines evenly in all directions.
    obstructed : bool
        Whether the machine's solids stand in it, which block light and reflect it.
    """

    rig: Rig
    material: Material
    events: frozenset[Event]
    housing: Housing | None = None
    mirrors: tuple[Mirror, ...] = ()
    lamp_cosine: bool = True
    obstructed: bool = False

    @property
    def plain(self) -> bool:
        """Whether the sample is flat, level and alike everywhere."""
        return self.material.mounting == PLAIN

    @property
    def curved_mirrors(self) -> bool:
        """Whether some mirror is curved, and so shows no image that stays in its place."""
        return any(isinstance(mirror, SphericalMirror) for mirror in self.mirrors)

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
    """Return the housing of an albedo, of the rig's size or with room for both arms; None for albedo 0.

    Raises
    ------
    BadInput
        The rig's housing does not hold its arms.
    """
    if albedo == 0.0:
        return None
    reach = max(rig.lamp.distance_mm, rig.camera.distance_mm)
    half = rig.twin.housing_side_mm / 2.0 or HOUSING_HALF_SIZE * reach
    if half <= reach:
        what = f"a housing of {2.0 * half:g} mm does not hold arms of {reach:g} mm"
        raise BadInput(what, where="twin.housing_side_mm", todo=f"give more than {2.0 * reach:g}, or 0")
    return Housing(albedo, half)


def rig_housing(rig: Rig, albedo: float | None = None) -> Housing | None:
    """Return the housing that a rig file describes, perhaps of another albedo.

    Raises
    ------
    BadInput
        As `default_housing`.
    """
    return default_housing(rig, rig.twin.housing_albedo if albedo is None else albedo)


def rig_mirrors(rig: Rig) -> tuple[Mirror, ...]:
    """Return the mirrors that a rig file describes.

    Raises
    ------
    BadInput
        One of them cannot be.
    """
    return tuple(_mirror(described) for described in rig.twin.mirrors)


def _mirror(described: surroundings.PlanarMirror | surroundings.SphericalMirror) -> Mirror:
    fields = described.model_dump(exclude={"kind"})
    return PlanarMirror(**fields) if described.kind == "planar" else SphericalMirror(**fields)
