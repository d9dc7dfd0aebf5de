"""The solids of the default machine, which is the twin's, for any of its distances.

Lamp and camera hang on bent arms: a beam beside the sample that turns about its bearing, and a cross-beam
from the beam's end to above the sample. The camera's arm is the inner one and fits into a sphere; of the
light's arm only the lamp and its stem reach into that sphere. So the arms meet only where the camera's arm
crosses the line on which the lamp hangs.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rig.solids import Box, Capsule, Cylinder

if TYPE_CHECKING:
    from rig.parts import Camera, Lamp, Sample
    from rig.solids import Solid

_CAMERA_MM, _LAMP_MM = 600.0, 500.0
"""Distances that the sizes below suit; arms much shorter are also thinner."""

_BEAM_MM, _STEM_MM = 15.0, 8.0
"""Radii."""

_LAMP_LENGTH_MM, _LAMP_RADIUS_MM, _LAMP_WALL_MM = 70.0, 25.0, 10.0

_LENS_MM = 20.0
"""What the lens has around its pupil, and in front of it."""

_HOUSING_MM = (80.0, 110.0, 70.0)
"""The camera's housing: up and down, across, along the viewing direction."""

_BEARING_MM = 350.0
"""Distance of the camera's bearing from the sample."""

_APART_MM = 30.0
"""Between what the camera's arm sweeps and the light's arm."""

_RIM_MM = 5.0
"""By which the stage is wider than the sample."""


def default_solids(lamp: Lamp, camera: Camera, sample: Sample) -> tuple[Solid, ...]:
    """Describe the arms, lamp, camera, stage and base that suit the default machine's joints.

    Parameters
    ----------
    lamp, camera, sample : Lamp, Camera, Sample
        Their distances and diameters are kept.

    Returns
    -------
    tuple of Solid
    """
    pupil = camera.distance_mm
    scale = min(1.0, pupil / _CAMERA_MM, lamp.distance_mm / _LAMP_MM)
    beam, lens = scale * _BEAM_MM, scale * _LENS_MM
    up, across, deep = (scale * edge for edge in _HOUSING_MM)
    bearing = pupil * _BEARING_MM / _CAMERA_MM
    back = pupil + 2.0 * lens
    rear = back + deep - beam
    reach = max(math.hypot(bearing + beam, rear + beam), math.hypot(back + deep, up / 2.0, across / 2.0))
    lamp_end = lamp.distance_mm + scale * _LAMP_LENGTH_MM
    outer = max(reach, lamp_end) + scale * _APART_MM + beam
    lamp_radius = max(scale * _LAMP_RADIUS_MM, lamp.diameter_mm / 2.0 + scale * _LAMP_WALL_MM)
    stage = sample.diameter_mm / 2.0 + _RIM_MM
    post = bearing + 3.0 * beam
    # The wheel reaches 7.5 stage radii from the centre, or as far as the camera's post leaves room.
    spoke = min(stage, (post - 4.0 * beam) / 7.5)
    light, azimuth, elevation = "light_elevation", "camera_azimuth", "camera_elevation"
    return (
        Cylinder(
            name="lamp", link=light,
            from_mm=(0.0, 0.0, lamp.distance_mm), to_mm=(0.0, 0.0, lamp_end), radius_mm=lamp_radius,
        ),
        Capsule(
            name="lamp_stem", link=light,
            from_mm=(0.0, 0.0, lamp_end), to_mm=(0.0, 0.0, outer), radius_mm=scale * _STEM_MM,
        ),
        Capsule(
            name="light_cross_beam", link=light,
            from_mm=(0.0, 0.0, outer), to_mm=(0.0, outer, outer), radius_mm=beam,
        ),
        Capsule(
            name="light_beam", link=light,
            from_mm=(0.0, outer, 0.0), to_mm=(0.0, outer, outer), radius_mm=beam,
        ),
        Cylinder(
            name="lens", link=elevation,
            from_mm=(0.0, 0.0, pupil - lens), to_mm=(0.0, 0.0, back),
            radius_mm=camera.aperture_diameter_mm / 2.0 + lens,
        ),
        Box(
            name="camera", link=elevation,
            centre_mm=(0.0, 0.0, back + deep / 2.0), size_mm=(up, across, deep),
        ),
        Capsule(
            name="camera_cross_beam", link=elevation,
            from_mm=(0.0, -bearing, rear), to_mm=(0.0, 0.0, rear), radius_mm=beam,
        ),
        Capsule(
            name="camera_beam", link=elevation,
            from_mm=(0.0, -bearing, 0.0), to_mm=(0.0, -bearing, rear), radius_mm=beam,
        ),
        Box(
            name="camera_post", link=azimuth,
            centre_mm=(0.0, -post, -50.0), size_mm=(4.0 * beam, 2.0 * beam, 130.0),
        ),
        Cylinder(
            name="stage", link="turntable",
            from_mm=(0.0, 0.0, -30.0), to_mm=(0.0, 0.0, 0.0), radius_mm=stage,
        ),
        Cylinder(
            name="wheel", from_mm=(3.0 * spoke, 0.0, -60.0), to_mm=(3.0 * spoke, 0.0, -35.0),
            radius_mm=4.5 * spoke,
        ),
        Cylinder(
            name="plate", from_mm=(0.0, 0.0, -160.0), to_mm=(0.0, 0.0, -120.0),
            radius_mm=post + 2.0 * beam,
        ),
        Box(
            name="light_post", centre_mm=(0.0, outer + 3.0 * beam, -60.0),
            size_mm=(4.0 * beam, 2.0 * beam, 180.0),
        ),
    )  # fmt: skip
