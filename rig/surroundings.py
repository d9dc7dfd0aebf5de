"""What surrounds a machine's sample, for the twin: a housing, mirrors, and how exact its light has to be."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationError

from rig.errors import BadInput
from rig.parts import Part
from rig.rig_errors import explain
from rig.solids import Coordinate, Length, Point  # noqa: TC001 - pydantic reads them

Reflectance = Annotated[float, Field(gt=0, le=1)]


class PlanarMirror(Part):
    """A rectangle that mirrors on one side."""

    kind: Literal["planar"] = "planar"
    centre_mm: Point = Field(description="its middle (x, y, z) in the sample's frame, within 1e6 mm")
    across_mm: Point = Field(description="half of one side, from its middle; across x up faces the light")
    up_mm: Point = Field(description="half of the other side, at right angles")
    reflectance: Reflectance = Field(1.0, description="share of light that it throws back, above 0 to 1")


class SphericalMirror(Part):
    """A round part of a sphere that mirrors on one side."""

    kind: Literal["spherical"] = "spherical"
    vertex_mm: Point = Field(description="its middle (x, y, z) in the sample's frame, within 1e6 mm")
    facing: Point = Field(description="normal of its middle, any length but zero")
    radius_mm: Coordinate = Field(description="of the sphere: above 0 hollow, below 0 a ball, within 1e6 mm")
    rim_mm: Length = Field(description="radius of its rim, above 0 to that of the sphere")
    reflectance: Reflectance = Field(1.0, description="share of light that it throws back, above 0 to 1")


Mirror = Annotated[PlanarMirror | SphericalMirror, Field(discriminator="kind")]


class TwinLight(Part):
    """The twin's surroundings and its light; they change nothing on a real machine."""

    tolerance: float = Field(
        1e-3, gt=0, lt=1, description="error allowed of the light over the sample, relative, 0 to 1"
    )
    housing_albedo: float = Field(
        0.0, ge=0, lt=1, description="share of light that the walls reflect, from 0 (black), below 1"
    )
    housing_side_mm: float = Field(
        0.0, ge=0, le=2_000_000, description="of the cube of walls; 0: three times the longer arm"
    )
    stray_light: float = Field(
        0.0,
        ge=0,
        le=1,
        description="even light added to every lit frame, over what a perfect diffuser lit along its normal "
        "shows, 0 to 1",
    )
    mirrors: tuple[Mirror, ...] = Field(
        (), max_length=20, description="beside the sample, at most 20; they turn with it"
    )
    solids: bool = Field(
        False, description="whether the machine's solids shade and reflect light, at seconds a frame"
    )


def parse_mirror(line: str) -> PlanarMirror | SphericalMirror:
    """Read a mirror from one line, such as ``planar:centre_mm=0/80/60,across_mm=50/0/0,up_mm=0/20/40``.

    Parameters
    ----------
    line : str
        Its kind, then its fields as the rig file has them; numbers of a vector are divided by slashes.

    Raises
    ------
    BadInput
        It is none.
    """
    kind, _, rest = line.partition(":")
    fields: dict[str, object] = {"kind": kind}
    for pair in filter(None, rest.split(",")):
        name, equals, value = pair.partition("=")
        try:
            numbers = [float(number) for number in value.split("/")]
        except ValueError:
            numbers = []
        if not (equals and numbers):
            what = f"cannot read {pair!r}"
            raise BadInput(what, where=f"mirror {line}", todo="write field=number or field=x/y/z")
        fields[name] = numbers[0] if len(numbers) == 1 else tuple(numbers)
    content = {"mirrors": (fields,)}
    try:
        return TwinLight.model_validate(content).mirrors[0]
    except ValidationError as error:
        raise explain(error, content, TwinLight, f"mirror {line}") from None
