"""The guard of a session that was interrupted: a pose shot again shows whether the machine is still the same.

After an interruption the reference pose of each role that can be brought to the centre is shot again with
the exposures of its own frames. Both sets are merged, and the mean over the sample is compared band by band.
A step beyond the tolerance is refused; every comparison is in the journal. The guard's frames lie apart, in
`frames/guard`, and nothing on the way to samples reads them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capture.interruptions import REFERENCE
from capture.merge import Flag, merge
from capture.raw import read_raw
from capture.records import Held, PoseFlag, Role, ShotState
from capture.statistics import thinned
from capture.steps import go, require_same_camera, shoot
from capture.store import guard_series
from rig.devices import PoseGoal
from rig.devices import Shot as Exposure
from rig.errors import Refused
from rig.pixels import pixel_geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from pathlib import Path
    from typing import Any

    from bluesky.utils import Msg
    from numpy.typing import NDArray

    from capture.examine import Examiner
    from capture.records import Shot, Visit
    from capture.sensor import SensorModel
    from capture.steps import Messages
    from capture.store import Store
    from rig.description import Rig
    from rig.devices import ArmsDevice, CameraDevice

COVERAGE = 2.0
"""Standard uncertainties by which a step must exceed the tolerance to be refused."""

_SATURATED = Flag.OVER_RANGE | Flag.NEIGHBOUR_CLIPPED | Flag.NEAR_CLIPPED_USED | Flag.HOT


@dataclass(frozen=True, slots=True)
class Step:
    """Light of a pose now over what it was, by channel.

    Attributes
    ----------
    channels : tuple of str
    ratio, u_ratio : tuple of float
        Ratio of the means over the sample and its standard uncertainty, of noise only.
    """

    channels: tuple[str, ...]
    ratio: tuple[float, ...]
    u_ratio: tuple[float, ...]

    def beyond(self, tolerance: float) -> tuple[str, ...]:
        """Channels that have certainly changed by more than a share: |ratio - 1| - 2 u > tolerance."""
        rows = zip(self.channels, self.ratio, self.u_ratio, strict=True)
        return tuple(name for name, ratio, u in rows if abs(ratio - 1.0) - COVERAGE * u > tolerance)

    def told(self) -> str:
        """Write it for a person: `G 1.034 +- 0.001`."""
        rows = zip(self.channels, self.ratio, self.u_ratio, strict=True)
        told = ", ".join(f"{name} {ratio:.4f} +- {u:.4f}" for name, ratio, u in rows)
        return told or "nothing that can be compared"


def compare(
    before: Sequence[Path],
    now: Sequence[Path],
    exposure_s: Sequence[float],
    *,
    rig: Rig,
    angles_rad: tuple[float, ...],
    sensor: SensorModel | None,
) -> Step:
    """Compare two sets of frames of one pose with the same exposures.

    The ratio is r = sum L_now / sum L_before over the pixels of a channel that see the sample and clip in
    neither set, with u(r)^2 = (sum v_now + r^2 sum v_before) / (sum L_before)^2 from the variances v of the
    merges. What both sets share, such as the darks and the sensor's inequality, cancels.

    Parameters
    ----------
    before, now : sequence of Path
    exposure_s : sequence of float
        Of either set.
    rig : Rig
    angles_rad : tuple of float
        Where the arms stood.
    sensor : SensorModel, optional

    Returns
    -------
    Step
        Of the channels that could be compared; none where every pixel clips or there is no light.
    """
    small = [[thinned(read_raw(path)) for path in paths] for paths in (before, now)]
    frame, rows, cols = small[0][0]
    seen = pixel_geometry(rig, angles_rad, rows=rows, cols=cols).on_sample
    merged = [merge([thin[0] for thin in frames], exposure_s, sensor=sensor) for frames in small]
    for one in merged:
        seen = seen & ((one.flags & np.uint8(_SATURATED)) == 0)
    height, width = frame.counts.shape
    channel = frame.cfa[np.arange(height)[:, None] % 2, np.arange(width)[None, :] % 2]
    ratios = {}
    for index, name in enumerate(frame.channels):
        pixels: NDArray[np.bool_] = seen & (channel == index)
        (light, noise), (light_now, noise_now) = (
            (
                float(np.sum(one.radiance[pixels], dtype=float)),
                float(np.sum(one.variance[pixels], dtype=float)),
            )
            for one in merged
        )
        if light > 0.0:
            ratio = light_now / light
            ratios[name] = (ratio, math.sqrt(noise_now + ratio**2 * noise) / light)
    return Step(tuple(ratios), tuple(r for r, _ in ratios.values()), tuple(u for _, u in ratios.values()))


@dataclass(frozen=True)
class ReferenceGuard:
    """Shoots reference poses again and compares.

    Attributes
    ----------
    rig : Rig
    arms, camera
        The machine's devices.
    store : Store
    examiner : Examiner
    sensor : SensorModel or None
    plan_hash : str
    tolerance : float
        Largest step of the light that is accepted, as a share.
    say : callable
        Told in one line what came of it.
    """

    rig: Rig
    arms: ArmsDevice
    camera: CameraDevice
    store: Store
    examiner: Examiner
    sensor: SensorModel | None
    plan_hash: str
    tolerance: float
    say: Callable[[str], None]

    def check(self, role: Role, why: str) -> Messages:
        """Plan the comparison of each role that can be compared while one is to be measured.

        Parameters
        ----------
        role : Role
            What is about to be measured: on a machine without a wheel nothing else is at the centre.
        why : str
            What interrupted the session.

        Yields
        ------
        Msg

        Raises
        ------
        Refused
            The light of a reference pose has changed by more than the tolerance.
        """
        for candidate in (Role.WHITE, Role.SAMPLE):
            visit = self._reference(candidate)
            if visit is not None and (self.rig.stations or candidate is role):
                yield from self._compare(visit, why)

    def _reference(self, role: Role) -> Visit | None:
        """Choose the pose of a role whose light says least about the arms: far from the mirror direction."""
        journal = self.store.journal
        poses = {pose.index: pose for pose in journal.poses()}
        shot = {shot.visit for shot in journal.shots() if shot.state is ShotState.VERIFIED}

        def calm(visit: Visit) -> tuple[bool, float]:
            pose = poses[visit.pose]
            half = np.add(pose.wi, pose.wo)
            return bool(visit.flags & ~PoseFlag.NOISY), float(half[2] / np.linalg.norm(half))

        done = [visit for visit in journal.visits() if visit.done and visit.role is role]
        return min((visit for visit in done if visit.number in shot), key=calm, default=None)

    def _compare(self, visit: Visit, why: str) -> Messages:
        journal = self.store.journal
        shots = [shot for shot in journal.shots(visit.number) if shot.state is ShotState.VERIFIED]
        pose = yield from go(self.arms, PoseGoal(visit.angles_rad, visit.station))
        series = guard_series(self.plan_hash, len(journal.events()))
        files = []
        for shot in shots:
            file = yield from self._shoot(f"{series}-{shot.frame}", shot)
            files.append(file)
        step = compare(
            [self.store.folder / str(shot.path) for shot in shots],
            [self.store.folder / file["path"] for file in files],
            [shot.exposure_s for shot in shots],
            rig=self.rig,
            angles_rad=pose.angles_rad,
            sensor=self.sensor,
        )
        beyond = step.beyond(self.tolerance)
        held = Held(pose.ticks, pose.angles_rad)
        journal.note(
            REFERENCE,
            why=why,
            role=visit.role,
            pose=visit.pose,
            held_ticks=[visit.held.ticks if visit.held else None, held.ticks],
            channels=step.channels,
            ratio=step.ratio,
            u_ratio=step.u_ratio,
            tolerance=self.tolerance,
            accepted=not beyond,
            files=files,
        )
        self.say(f"reference pose, {visit.role} {visit.pose}, {why}: {step.told()} of what it was")
        if beyond:
            raise Refused(
                f"the light of the reference pose, {visit.role} {visit.pose}, has changed by more than "
                f"{self.tolerance:g}: {step.told()} of what it was",
                where=str(self.store.folder),
                todo="see whether lamp, camera or sample were touched and put them back, accept the step "
                "with --reference-tolerance, or begin a new session",
            )

    def _shoot(self, name: str, like: Shot) -> Generator[Msg, Any, dict[str, Any]]:
        """Shoot a frame like another one; return where it lies."""
        picture = yield from shoot(self.camera, Exposure(name, like.exposure_s), self.store.journal)
        require_same_camera(self.store.journal, self.examiner, picture)
        path, sha256 = self.store.keep_guard(picture, name)
        return {"path": path, "sha256": sha256, "exposure_s": like.exposure_s}
