"""Radiance at pixel centres through Mitsuba: one ray per pixel, the lamp asked directly, no noise.

Rays are our own, so that lens distortion is possible. A pose changes the lamp's position and the numbers of
which rays are made; neither compiles a kernel anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.kinematics import Kinematics
from simulator.light.evaluator import Evaluator, Rendering
from simulator.light.mitsuba_scene import camera_rays, point_lamp
from simulator.light.pixelwise import PointMethod
from simulator.materials import NOT_RENDERED, load_bsdf

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rig.description import Rig
    from simulator.light.paths import LightPaths
    from simulator.light.scene import Scene
    from simulator.materials import Material

Array = NDArray[np.float64]


class PixelCentreLight(Evaluator):
    """Light on one material, traced to every pixel's centre; covers LDE.

    Parameters
    ----------
    mi : module
        Mitsuba in an LLVM variant, `simulator.bsdfs` registered.
    rig : Rig
        The machine.
    material : Material
        What lies at the station.
    lamp_cosine : bool
        Whether the lamp shines with the cosine to its axis, as a disc does, not alike in all directions.
    """

    def __init__(self, mi: Any, rig: Rig, material: Material, *, lamp_cosine: bool = False) -> None:
        self._mi = mi
        self._lamp_cosine = lamp_cosine
        self._rig = rig
        self._kinematics = Kinematics(rig)
        self._rays = mi.Vector3f(camera_rays(rig).T.astype(np.float32))
        # A square and not Mitsuba's disk, whose tangents run outwards: the frame is the sample's everywhere.
        self._bsdf = load_bsdf(mi, material)
        sample = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale(rig.sample.diameter_mm / 2.0),
            "bsdf": self._bsdf,
        }
        self._scene = mi.load_dict(
            {"type": "scene", "sample": sample, "lamp": point_lamp(rig)}, optimize=False
        )
        self._parameters = mi.traverse(self._scene)
        self._share_kernels()

    def _share_kernels(self) -> None:
        """Make the material's numbers data, so that materials of one kind share a kernel."""
        import drjit as dr

        for name, _ in self._parameters:
            if name.startswith("sample.bsdf"):
                value = self._parameters[name]
                dr.make_opaque(value)
                self._parameters[name] = value
        self._parameters.update()

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:  # noqa: ARG002
        """Compute a pose; see `Evaluator.render`."""
        return Rendering(self.radiance(angles_rad), 1e-6, "one ray a pixel")

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
        import drjit as dr

        mi = self._mi
        frames = self._kinematics.frames(np.asarray(angles_rad))
        self._parameters["lamp.position"] = mi.Point3f(*frames.light_mm.tolist())
        self._parameters.update()
        right, down, forward = (self._data(mi.Vector3f, axis) for axis in frames.camera_rotation.T)
        origin = self._data(mi.Point3f, frames.camera_mm)
        si = self._scene.ray_intersect(
            mi.Ray3f(origin, right * self._rays.x + down * self._rays.y + forward * self._rays.z)
        )
        edge_mm = self._rig.sample.diameter_mm / 2.0
        seen = si.is_valid() & (dr.square(si.p.x) + dr.square(si.p.y) <= edge_mm**2)
        lamp, irradiance = self._scene.sample_emitter_direction(si, mi.Point2f(0.5, 0.5), True, seen)
        # Asked directly: a kernel that looked it up at each point would hold every BSDF of the process.
        value = self._bsdf.eval(mi.BSDFContext(), si, si.to_local(lamp.d), seen)
        if self._lamp_cosine:
            axis = self._data(mi.Vector3f, unit(frames.light_mm))
            irradiance *= dr.maximum(dr.dot(lamp.d, axis), 0.0)
        radiance = np.asarray(dr.select(seen, value * irradiance, 0.0), dtype=np.float64)
        return radiance.T.reshape(self._rig.camera.height_px, self._rig.camera.width_px, 3)

    @staticmethod
    def _data(kind: Any, numbers: Array) -> Any:
        """Return a vector that kernels read as data and do not compile in."""
        import drjit as dr

        vector = kind(*numbers.tolist())
        dr.make_opaque(vector)
        return vector


class PixelCentres(PointMethod):
    """One ray per pixel centre through Mitsuba, vectorised."""

    name = "pixel centres through Mitsuba"

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot; see `Method.obstacle`."""
        if not scene.material.rendered:
            return NOT_RENDERED
        return None if vector else "Mitsuba does not run vectorised"

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:  # noqa: ARG002
        """Predict the time of a pose; see `Method.seconds`."""
        return 8e-4 + 8e-8 * scene.rig.camera.width_px * scene.rig.camera.height_px

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Evaluator:  # noqa: ARG002
        """Set it to work; see `Method.build`."""
        return PixelCentreLight(mi, scene.rig, scene.material, lamp_cosine=scene.lamp_cosine)
