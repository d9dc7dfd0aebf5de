"""Radiance of a pose: what the wheel holds, lit by the lamp and seen by the camera.

For each station the light paths are written down and the cheapest method that covers them is chosen, once,
when the station is first looked at (`simulator.light.choice`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from simulator import bsdfs
from simulator.light.choice import Decision, Method, SceneFacts, choose_method
from simulator.light.path_tracer import PathLight
from simulator.light.pixel_centres import PixelCentreLight
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.reflectance import closed_form_reflectance, mitsuba_reflectance
from simulator.materials import ClosedFormMaterial, load_bsdf, station_materials
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rig.description import Rig
    from simulator.materials import Material

Array = NDArray[np.float64]


class Light(Protocol):
    """A method at work on one station."""

    def radiance(self, angles_rad: Sequence[float]) -> Array:
        """Radiance at level 1, shape (height, width, 3)."""
        ...


class Renderer:
    """Radiance of any station at any pose.

    Parameters
    ----------
    rig : Rig
        The machine.
    materials : mapping of str to (str or Material)
        What lies at its sample stations; see `simulator.materials`.
    variant : str, optional
        Variant of Mitsuba; by default the fastest that can run.
    white_rho : float, optional
        True albedo of the white; by default the one that the rig file states.
    housing_albedo : float
        Albedo of the housing; 0 is black surroundings.

    Raises
    ------
    BadInput
        A material is wrong, or a variant that does not exist is asked for.
    """

    def __init__(
        self,
        rig: Rig,
        materials: Mapping[str, str | Material],
        *,
        variant: str | None = None,
        white_rho: float | None = None,
        housing_albedo: float = 0.0,
    ) -> None:
        self._rig = rig
        rho = rig.white.rho if white_rho is None else white_rho
        kinds = {name: station.kind for name, station in rig.stations.items()}
        self.materials = station_materials(kinds, materials, rho)
        self._mi = load_mitsuba(variant)
        self._vector = not self._mi.variant().startswith("scalar")
        self._housing_albedo = housing_albedo
        bsdfs.register(self._mi)
        # Every material is looked at now: a mistake must not wait for the wheel.
        self.decisions = {name: self._decide(material) for name, material in self.materials.items()}
        self._lights: dict[str, Light] = {}
        self._last: tuple[tuple[str, tuple[float, ...]], Array] | None = None

    @property
    def variant(self) -> str:
        """Mitsuba's variant in use."""
        return str(self._mi.variant())

    def radiance(self, station: str | None, angles_rad: Sequence[float], level: float = 1.0) -> Array:
        """Radiance of a pose.

        The last pose is remembered, so that a bracket of exposures is rendered once.

        Parameters
        ----------
        station : str or None
            The station under the camera; None, or one that nothing was put on, is black.
        angles_rad : sequence of float
            True angles of the arm joints, in the order of `rig.arm_joints`.
        level : float
            Lamp level, 0 to 1.

        Returns
        -------
        ndarray, shape (height, width, 3)
            In units in which a white of albedo rho at normal incidence and level 1 has rho/pi.
        """
        if station is None or station not in self.materials:
            return np.zeros((self._rig.camera.height_px, self._rig.camera.width_px, 3))
        pose = (station, tuple(float(angle) for angle in angles_rad))
        if self._last is None or self._last[0] != pose:
            self._last = (pose, self._light(station).radiance(pose[1]))
        return level * self._last[1]

    def prewarm(self) -> None:
        """Build every station's method and its kernels, so that the first frame is as fast as the rest."""
        for station in self.materials:
            self._light(station)
        # Not in one loop: kernels depend on which scenes exist when they are compiled.
        upright = [0.0] * len(self._rig.arm_joints)
        for station in self.materials:
            self.radiance(station, upright)

    def _decide(self, material: Material) -> Decision:
        return choose_method(self._facts(material), vector=self._vector)

    def _facts(self, material: Material) -> SceneFacts:
        if isinstance(material, ClosedFormMaterial):
            dark = not any(any(values) for name, values in material.truth.items() if name in {"kd", "ks"})
            return SceneFacts(scatters=not dark, closed_form=True, housing_albedo=self._housing_albedo)
        mi, bsdf = self._mi, load_bsdf(self._mi, material)
        return SceneFacts(
            scatters=bool(bsdf.flags() & mi.BSDFFlags.Smooth),
            mirrors=bool(bsdf.flags() & mi.BSDFFlags.Delta),
            housing_albedo=self._housing_albedo,
        )

    def _light(self, station: str) -> Light:
        if station not in self._lights:
            self._lights[station] = self._build(self.materials[station], self.decisions[station].method)
        return self._lights[station]

    def _build(self, material: Material, method: Method) -> Light:
        if method is Method.PIXEL_CENTRES:
            return PixelCentreLight(self._mi, self._rig, material)
        if method is Method.PATH:
            mirrors = self._facts(material).mirrors
            return PathLight(
                self._mi, self._rig, material, housing_albedo=self._housing_albedo, mirrors=mirrors
            )
        if method is Method.PIXEL_BY_PIXEL:
            return PixelwiseLight(self._rig, mitsuba_reflectance(self._mi, material))
        if method is Method.CLOSED_FORM and isinstance(material, ClosedFormMaterial):
            return PixelwiseLight(self._rig, closed_form_reflectance(material))
        return _Black(self._rig)


class _Black:
    """What reflects nothing."""

    def __init__(self, rig: Rig) -> None:
        self._radiance = np.zeros((rig.camera.height_px, rig.camera.width_px, 3))

    def radiance(self, angles_rad: Sequence[float]) -> Array:  # noqa: ARG002 - the same at every pose
        """Zero."""
        return self._radiance
