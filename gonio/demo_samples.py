"""What the demonstration measures: three materials, each with the poses that determine its model.

Only the standard library is used, so that a command can look at it without loading anything.
"""

from __future__ import annotations

from dataclasses import dataclass

Pose = tuple[float, float, float, float]
"""theta_i, phi_i, theta_o, phi_o in degrees."""

MIN_SEPARATION_DEG = 14.0
"""Poses whose light and camera stand closer than this are left out: the machine would refuse them."""


@dataclass(frozen=True)
class DemoSample:
    """One material of the demonstration.

    Attributes
    ----------
    name : str
        What people call it.
    station : str
        Where it lies on the station wheel.
    material : str
        Its specification, as `gonio sim --station` takes it.
    model : str
        The model to fit.
    poses : tuple of Pose
        Where to look from, in the order of travel.
    """

    name: str
    station: str
    material: str
    model: str
    poses: tuple[Pose, ...]


def scan(theta_i_deg: float, camera_deg: tuple[float, ...], phi_o_deg: float = 180.0) -> list[Pose]:
    """List one scan of the camera over a half circle at a fixed light.

    Parameters
    ----------
    theta_i_deg : float
        Where the light stands, in the plane phi = 0.
    camera_deg : tuple of float
        Signed camera angles, positive towards `phi_o_deg`.
    phi_o_deg : float
        The half circle's azimuth; 180 is the mirror's side.
    """
    back_deg = (phi_o_deg + 180.0) % 360.0
    poses = [(theta_i_deg, 0.0, abs(angle), phi_o_deg if angle >= 0 else back_deg) for angle in camera_deg]
    in_plane = phi_o_deg == 180.0
    return [
        pose
        for pose, angle in zip(poses, camera_deg, strict=True)
        if not in_plane or abs(angle + theta_i_deg) >= MIN_SEPARATION_DEG
    ]


def steps(first_deg: float, last_deg: float, step_deg: float) -> tuple[float, ...]:
    """List angles from `first_deg` to `last_deg`, both included."""
    count = round((last_deg - first_deg) / step_deg)
    return tuple(first_deg + index * step_deg for index in range(count + 1))


DIFFUSE = (
    *scan(10.0, steps(-70.0, 70.0, 10.0)),
    *scan(35.0, steps(-70.0, 70.0, 10.0)),
    *scan(60.0, steps(-75.0, 75.0, 10.0)),
    *scan(45.0, steps(-60.0, 60.0, 10.0), 90.0),
    *scan(75.0, (-30.0, 0.0, 30.0, 60.0, 75.0)),
    *scan(20.0, steps(15.0, 65.0, 10.0), 135.0),
)

GLOSSY = (
    *scan(20.0, (-70.0, -55.0, -40.0, *steps(-5.0, 45.0, 5.0), 55.0, 70.0)),
    *scan(40.0, (-75.0, -60.0, -20.0, *steps(10.0, 70.0, 5.0))),
    *scan(60.0, (-40.0, -20.0, 0.0, 15.0, *steps(30.0, 78.0, 6.0))),
    *scan(30.0, steps(0.0, 40.0, 5.0), 150.0),
    *scan(50.0, steps(20.0, 70.0, 10.0), 165.0),
    *scan(25.0, (20.0, 40.0, 60.0), 90.0),
)

MICROFACET = (
    *scan(20.0, (-70.0, -50.0, *steps(0.0, 40.0, 5.0), 55.0, 70.0)),
    *scan(45.0, (-75.0, -20.0, *steps(20.0, 72.0, 6.5))),
    *scan(65.0, (-35.0, 0.0, *steps(40.0, 80.0, 5.0))),
    *scan(72.0, (-40.0, 10.0, *steps(44.0, 80.0, 6.0))),
    *scan(77.0, (20.0, *steps(48.0, 80.0, 8.0))),
    *scan(35.0, steps(5.0, 55.0, 10.0), 165.0),
    *scan(68.0, (45.0, 55.0, 65.0, 75.0), 170.0),
    *scan(30.0, (20.0, 40.0, 60.0), 90.0),
)

SAMPLES = (
    DemoSample("Matte paint", "sample1", "lambert:kd=0.62/0.44/0.21", "lambert", DIFFUSE),
    DemoSample("Glossy paint", "sample2", "phong:kd=0.18/0.32/0.46,ks=0.6,exponent=30", "phong", GLOSSY),
    DemoSample(
        "Rough dielectric",
        "sample3",
        "cook-torrance:kd=0.32/0.16/0.09,ks=0.8,m=0.2,ior=1.5",
        "cook-torrance",
        MICROFACET,
    ),
)


def few(poses: tuple[Pose, ...], count: int | None) -> tuple[Pose, ...]:
    """Choose `count` poses, evenly over the list; all of them for None or more than there are."""
    if count is None or count >= len(poses):
        return poses
    return tuple(poses[index * len(poses) // count] for index in range(count))
