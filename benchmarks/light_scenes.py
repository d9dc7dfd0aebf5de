"""Scenes drawn from a seed: every kind of material, lamps, distances, apertures, housings, mirrors, poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.models import MODELS
from rig.angles import unit
from rig.description import Camera, Lamp, default_rig
from rig.kinematics import Kinematics
from simulator.light.mitsuba_scene import sample_events
from simulator.light.scene import PlanarMirror, Scene, default_housing
from simulator.materials import parse_material

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rig.description import Rig

Array = NDArray[np.float64]

ROUGHNESS = (0.05, 1.0)
ALBEDO = 0.3
GRAZING_DEG = 85.0
SIDES_PX = (64, 96, 128)
_WIDTHS = {"m", "m_x", "m_y", "alpha", "alpha_x", "alpha_y", "alpha_retro", "half_width_rad"}
_LEFT_ALONE = {"lafortune", "lafortune-retro", "abc"}
"""Models whose widths are no roughness: with their default shapes."""


@dataclass(frozen=True)
class Drawn:
    """A scene and a pose.

    Attributes
    ----------
    scene : Scene
    pose : tuple of float
        Joint angles in radians.
    label : str
        For people.
    """

    scene: Scene
    pose: tuple[float, ...]
    label: str


def draw_scenes(mi: Any, count: int, seed: int) -> Iterator[Drawn]:
    """Draw scenes: half in black surroundings, a third with a mirror, every fifth at grazing angles.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    count, seed : int
        How many, and which.
    """
    rng = np.random.default_rng(seed)
    names = rng.permutation(list(MODELS))
    for number in range(count):
        rig = _rig(rng)
        model = "lambert" if number % 8 == 0 else str(names[number % len(names)])
        line = _line(rng, model)
        material = parse_material(line)
        albedo = 0.0 if rng.uniform() < 0.5 else float(rng.uniform(0.0, ALBEDO))
        pose = _pose(rng, grazing=number % 5 == 4)
        mirrors = (_mirror(rng, rig, pose),) if number % 3 == 2 else ()
        scene = Scene(
            rig, material, sample_events(mi, material), default_housing(rig, albedo), mirrors=mirrors
        )
        label = f"{number}: {line}, housing {albedo:.2f}, {len(mirrors)} mirrors"
        yield Drawn(scene, pose, f"{label}, {np.round(np.degrees(pose), 1).tolist()} deg")


def _rig(rng: np.random.Generator) -> Rig:
    """Lamps from points to half the sample, apertures of all sizes; half of the sample fills the frame."""
    side = int(rng.choice(SIDES_PX))
    base = default_rig()
    distance = float(rng.uniform(300.0, 900.0))
    lamp_mm, aperture_mm = 10.0 ** rng.uniform([0.0, 0.0], [1.4, 1.3])
    camera = Camera(
        distance_mm=distance,
        width_px=side,
        height_px=side,
        focal_length_px=side * distance / 30.0,
        principal_point_px=((side - 1) / 2.0, (side - 1) / 2.0),
        aperture_diameter_mm=float(aperture_mm),
    )
    lamp = Lamp(
        **{
            **base.lamp.model_dump(),
            "distance_mm": float(rng.uniform(300.0, 900.0)),
            "diameter_mm": float(lamp_mm),
        }
    )
    return default_rig(camera=camera, lamp=lamp)


def _line(rng: np.random.Generator, model: str) -> str:
    """Draw a material's line."""
    values: dict[str, float] = {}
    roughness = np.exp(rng.uniform(*np.log(ROUGHNESS)))
    for parameter in MODELS[model].PARAMETERS:
        name, (low, high) = parameter.name, parameter.bounds
        if name == "kd":
            values[name] = rng.uniform(0.02, 0.6)
        elif name == "ks":
            values[name] = rng.uniform(0.05, 0.4)
        elif model in _LEFT_ALONE:
            values[name] = parameter.default
        elif name in _WIDTHS:
            values[name] = np.clip(roughness * rng.uniform(0.8, 1.2), low, min(high, 1.0))
        elif name.startswith("exponent"):
            values[name] = np.clip(2.0 / roughness**2, low, high)
        else:
            values[name] = parameter.default
    return f"{model}:" + ",".join(f"{name}={value:.4g}" for name, value in values.items())


def _pose(rng: np.random.Generator, *, grazing: bool) -> tuple[float, ...]:
    """Draw a pose: anywhere, in the mirror direction, or with lamp or camera near the horizon."""
    light, camera = np.radians(rng.uniform(-70.0, 70.0, 2))
    azimuth, table = np.radians(rng.uniform(-170.0, 170.0, 2))
    if grazing:
        low = np.radians(rng.uniform(78.0, GRAZING_DEG)) * rng.choice([-1.0, 1.0])
        light, camera = (low, camera) if rng.uniform() < 0.5 else (light, low)
    elif rng.uniform() < 0.5:
        camera, azimuth = np.array([-light, 0.0]) + rng.normal(0.0, 0.1, 2)
    return float(light), float(azimuth), float(camera), float(table)


def _mirror(rng: np.random.Generator, rig: Rig, pose: tuple[float, ...]) -> PlanarMirror:
    """Draw a mirror that stands beside the sample, leans over it, and hides neither lamp nor camera."""
    frames = Kinematics(rig).frames(pose)
    while True:
        turn, lean = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.6, 0.6)
        outwards = np.array([np.cos(turn), np.sin(turn), 0.0])
        half = rng.uniform([20.0, 15.0], [80.0, 50.0])
        centre = outwards * rng.uniform(60.0, 140.0) + [0.0, 0.0, half[1] + 5.0]
        across = half[0] * np.array([-np.sin(turn), np.cos(turn), 0.0])
        normal = -np.cos(lean) * outwards + np.sin(lean) * np.array([0.0, 0.0, 1.0])
        up = half[1] * np.cross(normal, unit(across))
        mirror = PlanarMirror(
            *(tuple(map(float, vector)) for vector in (centre, across, up)), float(rng.uniform(0.5, 1.0))
        )
        if not any(_hides(mirror, rig, place) for place in (frames.light_mm, frames.camera_mm)):
            return mirror


def _hides(mirror: PlanarMirror, rig: Rig, place_mm: Array) -> bool:
    """Tell whether a mirror comes near the ways between a place and the sample."""
    radius = rig.sample.diameter_mm / 2.0
    phi = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ends = np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi]) * 1.1 * radius
    t = np.linspace(0.0, 1.0, 200)[:, None, None]
    ways = (1.0 - t) * ends + t * place_mm
    way = ways - np.asarray(mirror.centre_mm)
    inside = np.ones(way.shape[:2], dtype=bool)
    for side in (np.asarray(mirror.across_mm), np.asarray(mirror.up_mm)):
        inside &= np.abs(way @ side) <= 1.2 * (side @ side)
    before = way @ mirror.normal
    return bool(np.any((before.min(axis=0) < 0.0) & (np.abs(before) < 20.0).any(axis=0) & inside.any(axis=0)))
