"""The solids of a machine as `rig.toml` writes them: boxes, rods and balls, with unit and range.

A solid is written down where it stands while all joints are at zero, in millimetres in the sample's frame at
that pose (origin on the sample's surface, +z its normal): that is where a person can measure it. `link` names
the joint that carries it from there; "base" stands still. `rig.placement` says where it is at any other pose.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from rig.parts import Name, Part

BASE = "base"
"""The link that stands still."""

Coordinate = Annotated[float, Field(ge=-1_000_000, le=1_000_000)]
Length = Annotated[float, Field(gt=0, le=1_000_000)]
Point = tuple[Coordinate, Coordinate, Coordinate]


class _Solid(Part):
    """What all solids have."""

    name: Name = Field(description="unique name of letters, digits, _ and -, at most 40")
    link: Name = Field(BASE, description='the joint that carries it, or "base" for what stands still')
    albedo: float = Field(
        0.04, ge=0, le=1, description="share of light that its surface reflects, 0 to 1; for the twin"
    )


class Box(_Solid):
    """A box."""

    kind: Literal["box"] = "box"
    centre_mm: Point = Field(description="its centre (x, y, z), all joints at zero, within 1e6 mm")
    size_mm: tuple[Length, Length, Length] = Field(
        description="its edges along its own x, y, z, each above 0 to 1e6 mm"
    )
    turn_deg: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0),
        description="how it is turned: right-handed about the fixed x, then y, then z axis, degrees",
    )


class Cylinder(_Solid):
    """A round rod or disc with flat ends."""

    kind: Literal["cylinder"] = "cylinder"
    from_mm: Point = Field(description="centre of one end (x, y, z), all joints at zero, within 1e6 mm")
    to_mm: Point = Field(description="centre of the other end, another point, within 1e6 mm")
    radius_mm: Length = Field(description="its radius, above 0 to 1e6 mm")


class Capsule(_Solid):
    """A rod with round ends: all points within a radius of a line."""

    kind: Literal["capsule"] = "capsule"
    from_mm: Point = Field(description="one end of the line (x, y, z), all joints at zero, within 1e6 mm")
    to_mm: Point = Field(description="its other end, another point, within 1e6 mm")
    radius_mm: Length = Field(description="its radius, above 0 to 1e6 mm")


class Sphere(_Solid):
    """A ball."""

    kind: Literal["sphere"] = "sphere"
    centre_mm: Point = Field(description="its centre (x, y, z), all joints at zero, within 1e6 mm")
    radius_mm: Length = Field(description="its radius, above 0 to 1e6 mm")


Solid = Annotated[Box | Cylinder | Capsule | Sphere, Field(discriminator="kind")]
