"""Radiance at pixel centres from f_r alone: geometry in float64, no ray is traced.

With one flat sample, a lamp small enough to be a point and black surroundings the light paths are LDE, and
the radiance of a pixel is f_r(wi, wo) E, with E = level (d/r)^2 cos theta_i at the point where the ray
through the pixel's centre meets the sample. A lamp that is a small disc shines with the cosine to its axis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import irradiance, pixel_geometry
from simulator.light.costs import GEOMETRY_S, MITSUBA_VALUE_S, ONE_BY_ONE_S, value_s
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.finite_size import pose_error, pose_errors
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance, mitsuba_reflectance
from simulator.materials import NOT_RENDERED

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.description import Rig
    from simulator.light.scene import Scene

Array = NDArray[np.float64]

_ROUNDING = 1e-6
"""Of f_r in single precision; float64's is far below."""


class PixelwiseLight(Evaluator):
    """Light on one material, asked for its f_r at every pixel's centre.

    Parameters
    ----------
    rig : Rig
        The machine.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    lamp_cosine : bool
        Whether the lamp shines with the cosine to its axis, as a disc does, not alike in all directions.
    """

    def __init__(
        self, rig: Rig, reflectance: Callable[[Array, Array], Array], *, lamp_cosine: bool = False
    ) -> None:
        self._rig = rig
        self._reflectance = reflectance
        self._kinematics = Kinematics(rig) if lamp_cosine else None

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:  # noqa: ARG002
        """Compute a pose; see `Evaluator.render`."""
        return Rendering(self.radiance(angles_rad), _ROUNDING, "one value of f_r a pixel")

    def radiance(self, angles_rad: Sequence[float]) -> Array:
        """Radiance at level 1.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.

        Returns
        -------
        ndarray, shape (height, width, 3)
            Zero beside the sample.
        """
        pixels = pixel_geometry(self._rig, np.asarray(angles_rad))
        seen = pixels.on_sample & (pixels.wi[..., 2] > 0.0)
        radiance = np.zeros((*seen.shape, 3))
        received = irradiance(self._rig, pixels)[seen]
        if self._kinematics is not None:
            lamp_mm = self._kinematics.frames(np.asarray(angles_rad)).light_mm
            received *= np.maximum(pixels.wi[seen] @ unit(lamp_mm), 0.0)
        radiance[seen] = self._reflectance(pixels.wi[seen], pixels.wo[seen]) * received[:, None]
        return radiance


class PointMethod(Method):
    """What all methods share that take lamp, pixel and pupil for points."""

    covers = LightPaths("LDE")

    def foresee(self, mi: Any, scene: Scene, poses_rad: Sequence[tuple[float, ...]]) -> None:
        """Estimate for many poses at once; see `Method.foresee`."""
        if scene.plain:
            pose_errors(mi, scene, poses_rad)

    def leaves_out(self, mi: Any, scene: Scene, angles_rad: Sequence[float]) -> float:
        """Estimate what a lamp, a pixel and a pupil with a size would change; see `Method.leaves_out`."""
        return pose_error(mi, scene, tuple(angles_rad))


class ClosedForm(PointMethod):
    """f_r in float64 at pixel centres."""

    name = "closed form at pixel centres"

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot; see `Method.obstacle`."""
        known = scene.material.has_closed_form
        return None if known else "the material has no closed form"

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:  # noqa: ARG002
        """Predict the time of a pose; see `Method.seconds`."""
        pixels = scene.rig.camera.width_px * scene.rig.camera.height_px
        return 3e-4 + (GEOMETRY_S + value_s(scene.material, vector=vector)) * pixels

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Evaluator:  # noqa: ARG002
        """Set it to work; see `Method.build`."""
        reflectance = material_reflectance(mi, scene.material)
        return PixelwiseLight(scene.rig, reflectance, lamp_cosine=scene.lamp_cosine)


class PixelByPixel(PointMethod):
    """One BSDF value of Mitsuba's for each pixel centre."""

    name = "one BSDF value per pixel"

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot; see `Method.obstacle`."""
        return None if scene.material.rendered else NOT_RENDERED

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:  # noqa: ARG002
        """Predict the time of a pose; see `Method.seconds`."""
        pixels = scene.rig.camera.width_px * scene.rig.camera.height_px
        return 7e-4 + (GEOMETRY_S + (MITSUBA_VALUE_S if vector else ONE_BY_ONE_S)) * pixels

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Evaluator:  # noqa: ARG002
        """Set it to work; see `Method.build`."""
        reflectance = mitsuba_reflectance(mi, scene.material)
        return PixelwiseLight(scene.rig, reflectance, lamp_cosine=scene.lamp_cosine)
