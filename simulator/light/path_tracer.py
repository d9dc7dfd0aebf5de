"""Radiance by Mitsuba's path tracer: for mirrors and housings, and the reference of every cheaper method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.errors import Refused
from rig.kinematics import Kinematics
from simulator.light import mitsuba_scene
from simulator.light.scene import HOUSING_HALF_SIZE
from simulator.materials import load_bsdf
from simulator.sensor import derived_seed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rig.description import Rig
    from simulator.materials import Material

Array = NDArray[np.float64]

DEEPEST = 12
"""Events after which a path ends: a housing of albedo 0.5 has lost all but 1e-4 of the light by then."""


class Estimate(NamedTuple):
    """Mean of independent renders, and the standard error of the mean; each (height, width, 3)."""

    mean: Array
    standard_error: Array


class PathLight:
    """Light on one material, path traced; covers L(D|S)+E.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    rig : Rig
        The machine.
    material : Material
        What lies at the station.
    housing_albedo : float
        Albedo of the housing; 0 for none.
    mirrors : bool
        Whether light can meet a mirror: the lamp is then a disc of its diameter, because mirrors never show
        a point. Otherwise it is a point, as for every cheaper method.
    samples_per_pixel : int
        Paths per pixel; in LLVM a power of two.

    Raises
    ------
    Refused
        The camera has distortion, which Mitsuba's cannot have.
    """

    def __init__(
        self,
        mi: Any,
        rig: Rig,
        material: Material,
        *,
        housing_albedo: float = 0.0,
        mirrors: bool = False,
        samples_per_pixel: int = 64,
    ) -> None:
        if any(rig.camera.distortion):
            what = "light paths beyond LDE cannot be rendered through a distorting lens"
            raise Refused(what, where="camera.distortion", todo="set it to zeros, or use black surroundings")
        self._mi, self._rig, self._kinematics = mi, rig, Kinematics(rig)
        self._samples_per_pixel, self._mirrors = samples_per_pixel, mirrors
        bsdf = load_bsdf(mi, material)
        # Mitsuba's disk has tangents that run outwards: no frame for a material with a grain.
        grain = bool(bsdf.flags() & mi.BSDFFlags.Anisotropic)
        description: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": DEEPEST, "rr_depth": DEEPEST, "hide_emitters": True},
            "camera": mitsuba_scene.perspective_camera(mi, rig, samples_per_pixel),
            "lamp": mitsuba_scene.disc_lamp(mi, rig) if mirrors else mitsuba_scene.point_lamp(rig),
            "sample": {
                "type": "rectangle" if grain else "disk",
                "to_world": mi.ScalarTransform4f().scale(rig.sample.diameter_mm / 2.0),
                "bsdf": bsdf,
            },
        }
        if housing_albedo > 0.0:
            half_size_mm = HOUSING_HALF_SIZE * max(rig.lamp.distance_mm, rig.camera.distance_mm)
            description["housing"] = mitsuba_scene.housing(mi, housing_albedo, half_size_mm)
        self._scene = mi.load_dict(description, optimize=False)
        self._parameters = mi.traverse(self._scene)

    def radiance(self, angles_rad: Sequence[float]) -> Array:
        """Radiance at level 1, the mean over each pixel; the noise depends on the pose and on nothing else.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.

        Returns
        -------
        ndarray, shape (height, width, 3)
        """
        self._pose(angles_rad)
        return self._render(derived_seed("paths", tuple(angles_rad)))

    def estimate(self, angles_rad: Sequence[float], renders: int) -> Estimate:
        """Mean and standard error over independent renders.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.
        renders : int
            How many, at least 2.
        """
        self._pose(angles_rad)
        images = np.stack([self._render(derived_seed("estimate", number)) for number in range(renders)])
        return Estimate(images.mean(axis=0), images.std(axis=0, ddof=1) / np.sqrt(renders))

    def _pose(self, angles_rad: Sequence[float]) -> None:
        mi, frames = self._mi, self._kinematics.frames(np.asarray(angles_rad))
        placed = mitsuba_scene.camera_placed(mi, frames.camera_mm, frames.camera_rotation)
        self._parameters["camera.to_world"] = mi.Transform4f(placed)
        if self._mirrors:
            lamp = mitsuba_scene.disc_lamp_placed(mi, self._rig, frames.light_mm)
            self._parameters["lamp.to_world"] = mi.Transform4f(lamp)
        else:
            self._parameters["lamp.position"] = mi.Point3f(*frames.light_mm.tolist())
        self._parameters.update()

    def _render(self, seed: int) -> Array:
        image = self._mi.render(self._scene, spp=self._samples_per_pixel, seed=seed % 2**32)
        return np.asarray(image, dtype=np.float64)
