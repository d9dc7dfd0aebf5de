"""What a scene's pixels see, by means of their own: nothing that the choice can choose between is believed.

Direct light is the float64 solver's, a full product of rules over lamp, pixel and pupil; light of the lamp
in a mirror is the mean over as many nodes of its virtual image's; all other light is a converged render,
whose noise is known and taken off the squared error. Over the sample that light is smooth: a polynomial is
fitted to the render, which takes off most of its noise, and what the render has beyond it and beyond its
noise is looked for; where there is something, means of small blocks are taken instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, uniform_filter

from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.classes import light_paths
from simulator.light.direct_float64 import Float64Nodes
from simulator.light.direct_view import extents_of, lens_of, view_of
from simulator.light.even_rules import even_rule
from simulator.light.path_classes import PathClasses
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance
from simulator.light.sparse_rules import Levels, product_rule
from simulator.light.virtual_lights import VirtualLights

if TYPE_CHECKING:
    from benchmarks.light_scenes import Drawn
    from simulator.light.path_tracer import Estimate

Array = NDArray[np.float64]

LEVELS = Levels(2, 1, 2)
GRID = 12
"""Rows and columns of pixels that are compared, evenly spread."""
EDGE_PX = 3
NODES = 4096
RENDERS, SAMPLES, LONGEST = 4, 64, 8
MOST_ROUNDS = 3
"""How often the render is made four times longer, as long as its noise counts."""
DEGREE = 6
"""Of the polynomial in both coordinates of a pixel together."""
BLOCK = 5
"""Pixels along each side of the block over which light that the polynomial does not follow is averaged."""
ENOUGH, UNEXPLAINED = 0.3, 0.2
"""Noise of the truth, and what its polynomial may miss, in units of the tolerance."""
DIRECT, IMAGES = LightPaths("LDE"), LightPaths("LS+DE")


@dataclass(frozen=True, eq=False)
class Truth:
    """Radiance of some pixels.

    Attributes
    ----------
    pixels : ndarray of int, shape (N,)
        Which, in rows one after the other.
    radiance : ndarray, shape (N, 3)
    variance : float
        Mean variance of its noise.
    """

    pixels: NDArray[np.intp]
    radiance: Array
    variance: float

    @property
    def mean(self) -> float:
        """Mean radiance."""
        return float(self.radiance.mean())

    @property
    def resolution(self) -> float:
        """Relative error that its noise hides."""
        spread = self.variance * np.sqrt(2.0 / max(1, len(self.pixels)))
        return float(np.sqrt(spread)) / self.mean

    def error(self, image: Array) -> float:
        """RMS error of an image (height, width, 3), relative to the mean radiance, without the noise."""
        squared = np.mean(np.square(image.reshape(-1, 3)[self.pixels] - self.radiance)) - self.variance
        return float(np.sqrt(max(0.0, squared))) / self.mean


def truth_of(mi: Any, drawn: Drawn, tolerance: float) -> Truth | None:
    """Compute what pixels see; None where too little of the sample is seen.

    Parameters
    ----------
    mi : module
        Mitsuba in an LLVM variant, `simulator.bsdfs` registered.
    drawn : Drawn
    tolerance : float
        The smallest that is to be told from larger errors.
    """
    scene, pose = drawn.scene, np.asarray(drawn.pose)
    seen = pixel_geometry(scene.rig, pose).on_sample
    inside = binary_erosion(seen, iterations=EDGE_PX, border_value=1)
    if np.count_nonzero(inside) < GRID:
        return None
    rows, cols = (((np.arange(GRID) + 0.5) * n / GRID).astype(int) for n in inside.shape)
    pixels = (rows[:, None] * inside.shape[1] + cols).ravel()
    pixels = pixels[inside.ravel()[pixels]]
    if len(pixels) < GRID:
        pixels = np.flatnonzero(inside)[:: max(1, np.count_nonzero(inside) // GRID**2)]
    radiance = _direct(mi, drawn, pixels) + _images(mi, drawn, pixels)
    rest = light_paths(scene) - DIRECT - IMAGES
    if not rest:
        return Truth(pixels, radiance, 0.0)
    traced = PathClasses(mi, scene, [rest], longest=LONGEST, samples_per_pixel=SAMPLES)
    renders = RENDERS
    for _ in range(MOST_ROUNDS):
        found = traced.estimates(drawn.pose, renders)[0]
        level = tolerance * float((radiance + found.mean.reshape(-1, 3)[pixels]).mean())
        smooth, variance = _smoothed(found, inside, UNEXPLAINED * level)
        truth = Truth(pixels, radiance + smooth.reshape(-1, 3)[pixels], variance)
        if truth.resolution < ENOUGH * tolerance:
            break
        renders *= 4
    return truth


def _smoothed(found: Estimate, inside: NDArray[np.bool_], unexplained: float) -> tuple[Array, float]:
    """Take off noise: the image (height, width, 3), and the variance that is left.

    Parameters
    ----------
    found : Estimate
    inside : ndarray of bool, shape (height, width)
        Pixels that see nothing but the sample.
    unexplained : float
        What a polynomial may miss, RMS.
    """
    rows, cols = (np.linspace(-1.0, 1.0, size) for size in inside.shape)
    y, x = (axis[inside] for axis in np.meshgrid(rows, cols, indexing="ij"))
    degrees = np.indices((DEGREE + 1, DEGREE + 1)).reshape(2, -1)
    basis = legendre.legvander2d(x, y, [DEGREE, DEGREE])[:, degrees.sum(axis=0) <= DEGREE]
    coefficients = np.linalg.lstsq(basis, found.mean[inside], rcond=None)[0]
    noise = float(np.square(found.standard_error[inside]).mean())
    fitted = found.mean.copy()
    fitted[inside] = basis @ coefficients
    rest = uniform_filter(np.where(inside[..., None], found.mean - fitted, 0.0), (BLOCK, BLOCK, 1))[inside]
    missed = float(np.square(rest).mean()) - noise / BLOCK**2
    if missed <= unexplained**2:
        return fitted, noise * basis.shape[1] / len(basis)
    return uniform_filter(found.mean, (BLOCK, BLOCK, 1)), noise / BLOCK**2


def _direct(mi: Any, drawn: Drawn, pixels: NDArray[np.intp]) -> Array:
    scene, extents = drawn.scene, extents_of(drawn.scene.rig)
    view = view_of(Kinematics(scene.rig).frames(np.asarray(drawn.pose)), extents)
    nodes = Float64Nodes(material_reflectance(mi, scene.material), extents, scene.sample_radius_mm)
    return np.asarray(nodes.radiance([view], lens_of(scene.rig)[pixels], product_rule(LEVELS))[0])


def _images(mi: Any, drawn: Drawn, pixels: NDArray[np.intp]) -> Array:
    """Light of the lamp's images, whatever their windows' edges."""
    scene, pose = drawn.scene, np.asarray(drawn.pose)
    radiance = np.zeros((len(pixels), 3))
    lights = VirtualLights(scene, material_reflectance(mi, scene.material), IMAGES)
    if not lights.lamps:
        return radiance
    view = view_of(Kinematics(scene.rig).frames(pose), extents_of(scene.rig))
    return lights.mean(view, lens_of(scene.rig)[pixels], even_rule(0, NODES, seed=1))
