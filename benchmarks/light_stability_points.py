"""Light at pixels' centres in 50 digits, and every evaluator that takes lamp, pixel and pupil for points.

Poses graze the sample or have no half vector, lobes are down to 1e-4 wide; the lens is so long that a lobe
spreads over many pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import mpmath as mp
import numpy as np

from benchmarks.models_digits import STEEPEST_DEG
from benchmarks.models_exact import DIGITS, FORMULAS, geometry
from benchmarks.rows import row
from rig.description import Camera, default_rig
from rig.kinematics import Kinematics
from simulator.light.direct import DirectLight
from simulator.light.direct_float64 import Float64Nodes
from simulator.light.direct_llvm import MitsubaNodes
from simulator.light.direct_view import POINTS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.pixel_centres import PixelCentreLight
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.reflectance import closed_form_reflectance, mitsuba_reflectance
from simulator.light.scene import Scene
from simulator.light.surface_light import SurfaceLight
from simulator.materials import closed_form_material
from simulator.variant import LLVM, choose_variant, load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from rig.description import Rig
    from simulator.light.evaluator import Evaluator
    from simulator.materials import ClosedFormMaterial

    Array = NDArray[np.float64]
    Radiance = Callable[[tuple[float, ...]], Array]

SIDE_PX = 9
RIG = default_rig(
    camera=Camera(
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        focal_length_px=90.0,
        principal_point_px=(SIDE_PX // 2, SIDE_PX // 2),
    )
)
_STEEP = np.radians(STEEPEST_DEG)
POSES: dict[str, tuple[float, ...]] = {
    "oblique": (0.5, 0.3, -0.45, 0.2),
    "mirror": (0.5, 0.0, -0.5, 0.0),
    "light and camera at the normal": (0.0, 0.0, 0.0, 0.0),
    "light behind the camera": (0.5, 0.0, 0.5, 0.0),
    "light at 89.999 deg": (_STEEP, 0.3, -0.45, 0.2),
    "camera at 89.999 deg": (0.5, 0.3, -_STEEP, 0.2),
    "both at 89.999 deg, opposite": (_STEEP, 0.0, -_STEEP, 0.0),
    "both at 89.999 deg, together": (_STEEP, 0.0, _STEEP, 0.0),
}
WIDTHS = (1e-4, 1e-2, 0.3, 10.0)
FAINT = 1e-6
"""Pixels below this share of the brightest one are not compared."""
TOLERANCE = 1e-2
"""That evaluators are asked for; what is compared is far finer."""
ROUNDING = {True: (1e-6, 6e-8), False: (1e-12, 2e-16)}
"""Relative error of single and of double precision where f_r is constant, and the error of a direction."""
STEEPEST = 8.0
"""Slope of a lobe's logarithm, times its width, at `FAINT` of the peak."""


def telephoto(m: float) -> Rig:
    """Return the rig with a lens that spreads a lobe of such a width over the frame, if it is narrow."""
    focal_length_px = max(RIG.camera.focal_length_px, 1.0 / m)
    return RIG.model_copy(
        update={"camera": RIG.camera.model_copy(update={"focal_length_px": focal_length_px})}
    )


def target(m: float, *, single: bool) -> float:
    """Return the bound of the relative error: a direction's last digit counts by the slope of the lobe."""
    value, step_rad = ROUNDING[single]
    return value + STEEPEST * step_rad / m


def lobe(m: float) -> ClosedFormMaterial:
    """Return facets of a width on a diffuse base."""
    return closed_form_material("cook-torrance", {"kd": 0.1, "ks": 0.5, "m": m, "ior": 1.5})


def exact_radiance(rig: Rig, material: ClosedFormMaterial, angles_rad: tuple[float, ...]) -> Array:
    """Radiance (height, width) at pixels' centres of a point lamp, in 50 digits; 0 beside the sample.

    From where lamp and camera stand on; their places are double precision's.
    """
    frames, camera = Kinematics(rig).frames(angles_rad), rig.camera
    radiance = np.zeros((camera.height_px, camera.width_px))
    with mp.workdps(DIGITS):
        light, eye = ([mp.mpf(float(x)) for x in place] for place in (frames.light_mm, frames.camera_mm))
        rotation = [[mp.mpf(float(x)) for x in line] for line in frames.camera_rotation]
        values = {name: mp.mpf(value) for name, value in material.parameters.items()}
        for v, u in np.ndindex(radiance.shape):
            pixel = [
                (mp.mpf(at) - centre) / mp.mpf(camera.focal_length_px)
                for at, centre in zip((u, v), camera.principal_point_px, strict=True)
            ]
            ray = [sum(a * b for a, b in zip(line, (*pixel, 1), strict=True)) for line in rotation]
            if ray[2] == 0 or -eye[2] / ray[2] <= 0:
                continue
            point = [e - eye[2] / ray[2] * r for e, r in zip(eye[:2], ray[:2], strict=True)]
            if sum(p * p for p in point) > mp.mpf(rig.sample.diameter_mm / 2.0) ** 2:
                continue
            to_light, to_eye = (
                [a - b for a, b in zip(end, (*point, 0), strict=True)] for end in (light, eye)
            )
            if to_light[2] <= 0 or to_eye[2] <= 0:
                continue
            squared = sum(x * x for x in to_light)
            irradiance = mp.mpf(rig.lamp.distance_mm) ** 2 * to_light[2] / squared ** mp.mpf("1.5")
            pair = geometry(to_light, to_eye)
            f_r = FORMULAS[material.model](pair, SimpleNamespace(**values))
            radiance[v, u] = float(f_r * irradiance)
    return radiance


@dataclass(frozen=True, eq=False)
class AtPoints:
    """An evaluator of points, and how exact it has to be.

    Attributes
    ----------
    name : str
    build : callable
        (mi, rig, material) -> radiance (height, width, 3) of a pose.
    single : bool
        Whether it is single precision's.
    vector : bool
        Whether it needs LLVM.
    """

    name: str
    build: Callable[[Any, Rig, ClosedFormMaterial], Radiance]
    single: bool = False
    vector: bool = False


def _rendered(evaluator: Evaluator) -> Radiance:
    return lambda pose: evaluator.render(pose, TOLERANCE).radiance


def _surface(mi: Any, rig: Rig, material: ClosedFormMaterial) -> Radiance:
    scene = Scene(rig, material, sample_events(mi, material))
    return _rendered(SurfaceLight(scene, closed_form_reflectance(material), None, POINTS))


def _double_nodes(mi: Any, rig: Rig, material: ClosedFormMaterial) -> Radiance:  # noqa: ARG001
    nodes = Float64Nodes(closed_form_reflectance(material), POINTS, rig.sample.diameter_mm / 2.0)
    return _rendered(DirectLight(rig, nodes, POINTS))


def _single_nodes(mi: Any, rig: Rig, material: ClosedFormMaterial) -> Radiance:
    nodes = MitsubaNodes(mi, material, POINTS, rig.sample.diameter_mm / 2.0)
    return _rendered(DirectLight(rig, nodes, POINTS))


def _closed_form(mi: Any, rig: Rig, material: ClosedFormMaterial) -> Radiance:  # noqa: ARG001
    return PixelwiseLight(rig, closed_form_reflectance(material)).radiance


def _bsdf_values(mi: Any, rig: Rig, material: ClosedFormMaterial) -> Radiance:
    return PixelwiseLight(rig, mitsuba_reflectance(mi, material)).radiance


def _pixel_centres(mi: Any, rig: Rig, material: ClosedFormMaterial) -> Radiance:
    return PixelCentreLight(mi, rig, material).radiance


AT_POINTS = (
    AtPoints("closed form at pixel centres", _closed_form),
    AtPoints("quadrature in float64", _double_nodes),
    AtPoints("sample's form in float64", _surface),
    AtPoints("one BSDF value per pixel", _bsdf_values, single=True),
    AtPoints("pixel centres through Mitsuba", _pixel_centres, single=True, vector=True),
    AtPoints("quadrature through Mitsuba", _single_nodes, single=True, vector=True),
)


def point_error(mi: Any, evaluator: AtPoints, m: float) -> tuple[float, str]:
    """Return the largest relative error of a pixel, infinite for a value that is no number, and its pose."""
    rig, material, worst = telephoto(m), lobe(m), (0.0, "none")
    radiance = evaluator.build(mi, rig, material)
    for name, pose in POSES.items():
        expected, values = exact_radiance(rig, material, pose), radiance(pose)[..., 0]
        seen = expected > FAINT * expected.max()
        error = np.max(np.abs(values - expected)[seen] / expected[seen], initial=0.0)
        worst = max(worst, (float(error) if np.isfinite(values).all() else np.inf, name))
    return worst


def run(plots: Path | None) -> Iterator[dict[str, Any]]:  # noqa: ARG001 - the interface of all parts
    """Measure every evaluator in the fastest variant that runs here."""
    from simulator import bsdfs

    mi = load_mitsuba(choose_variant().variant)
    bsdfs.register(mi)
    for evaluator in AT_POINTS:
        if evaluator.vector and mi.variant() != LLVM:
            continue
        for m in WIDTHS:
            error, pose = point_error(mi, evaluator, m)
            bound = target(m, single=evaluator.single)
            yield row(f"{evaluator.name}, m = {m:g}, worst: {pose}", error, "relative", bound)
