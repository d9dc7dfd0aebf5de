"""Radiance of a pose: what the wheel holds, lit by the lamp and seen by the camera.

For each pose it is decided what of the light is computed, by which methods, and what is skipped
(`simulator.light.choice`); methods are built when they are first needed, and kept.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator import bsdfs
from simulator.bands import seen_through
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.planner import Planner
from simulator.light.scene import Scene, rig_housing, rig_mirrors
from simulator.materials import station_materials
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rig.description import Rig
    from simulator.light.choice import Part
    from simulator.light.evaluator import Evaluator
    from simulator.light.planner import Plan
    from simulator.materials import Material

Array = NDArray[np.float64]


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
    trap_rho : float
        True albedo of the light trap; 0 is black.
    housing_albedo : float, optional
        Albedo of the housing; 0 is black surroundings; by default what the rig file says.
    tolerance : float, optional
        Error that is allowed, relative to the mean radiance over the sample;
        likewise.

    Attributes
    ----------
    materials : dict of str to Material
        By station.

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
        trap_rho: float = 0.0,
        housing_albedo: float | None = None,
        tolerance: float | None = None,
    ) -> None:
        self._rig = rig
        rho = rig.white.rho if white_rho is None else white_rho
        kinds = {name: station.kind for name, station in rig.stations.items()}
        self.materials = station_materials(kinds, materials, rho, trap_rho)
        self._mi = load_mitsuba(variant)
        bsdfs.register(self._mi)
        tolerance = rig.twin.tolerance if tolerance is None else tolerance
        housing, mirrors = rig_housing(rig, housing_albedo), rig_mirrors(rig)
        # Every material is looked at now: a mistake must not wait for the wheel.
        seen = {
            name: seen_through(rig, material, 0.1 * tolerance) for name, material in self.materials.items()
        }
        scenes = {
            name: Scene(rig, material, sample_events(self._mi, material), housing, mirrors)
            for name, material in seen.items()
        }
        self._planners = {
            name: Planner(self._mi, scene, tolerance, METHODS, follow_solids=rig.twin.solids)
            for name, scene in scenes.items()
        }
        self._evaluators: dict[tuple[Scene, str, tuple[str, ...]], Evaluator] = {}
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
            self._last = (pose, self._lit(*pose))
        return level * self._last[1]

    def plan(self, station: str, angles_rad: Sequence[float]) -> Plan:
        """Decide how a pose is rendered.

        Parameters
        ----------
        station : str
            One that something was put on.
        angles_rad : sequence of float
            As in `radiance`.

        Raises
        ------
        Refused
            No method covers its light.
        """
        return self._planners[station].plan(angles_rad)

    def prewarm(self) -> None:
        """Build every station's method and its kernels, so that the first frame is as fast as the rest."""
        # All are built before one renders: kernels depend on which scenes exist when they are compiled.
        upright = [0.0] * len(self._rig.arm_joints)
        for station in self.materials:
            for scene, part in self.plan(station, upright).parts:
                self._evaluator(scene, part)
        for station in self.materials:
            self.radiance(station, upright)

    def _lit(self, station: str, angles_rad: tuple[float, ...]) -> Array:
        radiance = np.zeros((self._rig.camera.height_px, self._rig.camera.width_px, 3))
        for scene, part in self.plan(station, angles_rad).parts:
            radiance += self._evaluator(scene, part).render(angles_rad, part.tolerance).radiance
        return radiance

    def _evaluator(self, scene: Scene, part: Part) -> Evaluator:
        key = scene, part.method.name, tuple(path_class.name for path_class in part.classes)
        if key not in self._evaluators:
            self._evaluators[key] = part.method.build(self._mi, scene, part.paths)
        return self._evaluators[key]
