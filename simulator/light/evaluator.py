"""What every way of computing light looks like from outside: one question, one kind of answer.

A `Method` is a row of the table that the choice goes through (`simulator.light.choice`): cheap to look at, it
tells which light paths it can compute and how long it would take. An `Evaluator` is a method at work on one
scene. A `Rendering` is its answer.

The truth that all approximate: the radiance of a pixel is the mean over the pixel's footprint, over the
entrance pupil and over the lamp's disc of f_r E, plus what every path over the surroundings adds; the lamp is
normalised so that the irradiance at the sample's centre at normal incidence is 1 at level 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from simulator.light.paths import LightPaths
    from simulator.light.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rendering:
    """Radiance of one pose, and how good it is.

    Attributes
    ----------
    radiance : ndarray, shape (height, width, 3)
        At level 1. What pixels beside the sample hold is not stated: methods differ there.
    error : float
        Estimated error (one standard deviation, or a bound), RMS over the pixels of the lit sample, relative
        to their mean radiance.
    did : str
        In words, what was done: nodes, sub-rays, samples, patches.
    """

    radiance: Array
    error: float
    did: str


class Evaluator(ABC):
    """A method at work on one scene."""

    @abstractmethod
    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute the radiance of a pose.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints, in the order of `rig.arm_joints`.
        tolerance : float
            The error wanted, as `Rendering.error` states it. A method that cannot reach it says so there.

        Returns
        -------
        Rendering
            Equal for equal arguments, whatever was asked before.
        """

    def render_many(self, poses_rad: Iterable[Sequence[float]], tolerance: float) -> Iterator[Rendering]:
        """Compute many poses, in one launch where the method can.

        Parameters
        ----------
        poses_rad : iterable of sequences of float
            As in `render`.
        tolerance : float
            As in `render`.

        Yields
        ------
        Rendering
            In the order of the poses.
        """
        for angles_rad in poses_rad:
            yield self.render(angles_rad, tolerance)


class Method(ABC):
    """A row of the table of methods: what it can compute, where, how long it takes.

    Attributes
    ----------
    name : str
        For people.
    covers : LightPaths
        It can compute every union of a scene's path classes inside this set, where `obstacle` has nothing
        against it.
    any_sample : bool
        Whether it serves samples that are not flat, level and alike everywhere; by default it does not, and
        is not asked about them.
    among_solids : bool
        Whether it serves scenes in which a machine's solids stand; by default it does not.
    """

    name: str
    covers: LightPaths
    any_sample: bool = False
    among_solids: bool = False

    @abstractmethod
    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:
        """Say why it cannot compute exactly these paths of a scene, or None.

        Parameters
        ----------
        scene : Scene
        paths : LightPaths
            Within `covers`; a union of the scene's path classes.
        vector : bool
            Whether Mitsuba runs vectorised (LLVM).
        """

    @abstractmethod
    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:
        """Predict the time of one pose, once it is built.

        Parameters
        ----------
        scene, paths, vector
            As in `obstacle`.
        tolerance : float
            The error wanted.
        """

    def seconds_at(
        self,
        mi: Any,  # noqa: ARG002
        scene: Scene,
        paths: LightPaths,
        tolerance: float,
        angles_rad: Sequence[float],  # noqa: ARG002
        *,
        vector: bool,
    ) -> float:
        """Predict the time of a certain pose; by default that of any.

        Parameters
        ----------
        mi, scene, paths, vector
            As in `build` and `obstacle`.
        tolerance : float
            The error wanted.
        angles_rad : sequence of float
            True angles of the arm joints.
        """
        return self.seconds(scene, paths, tolerance, vector=vector)

    @abstractmethod
    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Evaluator:
        """Set it to work on exactly `paths` of a scene.

        Parameters
        ----------
        mi : module
            Mitsuba, its variant set and `simulator.bsdfs` registered.
        scene : Scene
        paths : LightPaths
            As in `obstacle`.
        """

    def foresee(self, mi: Any, scene: Scene, poses_rad: Sequence[tuple[float, ...]]) -> None:  # noqa: B027
        """Prepare for questions about poses, many at once; by default there is nothing to prepare.

        Parameters
        ----------
        mi : module
            As in `build`.
        scene : Scene
        poses_rad : sequence of tuple of float
            True angles of the arm joints.
        """

    def leaves_out(self, mi: Any, scene: Scene, angles_rad: Sequence[float]) -> float:  # noqa: ARG002
        """Estimate the relative error that it leaves at a pose however long it works; by default none."""
        return 0.0
