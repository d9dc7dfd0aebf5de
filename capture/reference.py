"""References: a pose shot again shows whether the machine is still the same.

After an interruption, and where drift asks for it (`capture.drift`), reference poses are shot again with the
exposures of their own frames. Both sets are merged, and the mean over the sample is compared band by band,
less what the lamp's photodiode has seen of the difference. A step beyond the tolerance is refused; every
comparison is in the journal. The frames lie apart, in `frames/guard`, and nothing on the way to samples reads
them.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from capture.comparison import Comparison, FrameSet
from capture.drift import seconds_of
from capture.interruptions import REFERENCE
from capture.records import Held, PoseFlag, Role, ShotState
from capture.session import lamp_outputs
from capture.steps import go, require_same_camera, shoot
from capture.store import guard_series
from rig.devices import PoseGoal
from rig.devices import Shot as Exposure
from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Callable, Generator
    from typing import Any

    from bluesky.utils import Msg

    from capture.comparison import Step
    from capture.examine import Examiner
    from capture.records import Shot, Visit
    from capture.sensor import SensorModel
    from capture.steps import Messages
    from capture.store import Store
    from rig.description import Rig
    from rig.devices import ArmsDevice, CameraDevice


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
    lamp_deg_c : callable
        Gives the temperature of the lamp's head, None where it is not known.
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
    lamp_deg_c: Callable[[], float | None]
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
            visit = self._reference(candidate, role)
            if visit is not None:
                yield from self._compare_light(visit, why)

    def refresh(self, role: Role, why: str, predicted: dict[str, float]) -> Messages:
        """Plan the references that drift asks for: the white (or what is mounted), the light trap, a dark.

        Parameters
        ----------
        role : Role
            What is about to be measured.
        why : str
            What the drift is, for the journal.
        predicted : dict
            What was predicted, likewise.

        Yields
        ------
        Msg

        Raises
        ------
        Refused
            One of them has changed by more than the tolerance.
        """
        candidates = (self._reference(each, role) for each in (Role.WHITE, Role.SAMPLE))
        visit = next((found for found in candidates if found is not None), None)
        if visit is None:
            return
        yield from self._compare_light(visit, why, predicted=predicted)
        yield from self._compare_dark(visit, why)
        trap = self._reference(Role.TRAP, role)
        if trap is not None:
            yield from self._compare_trap(trap, why)

    def _reference(self, wanted: Role, role: Role) -> Visit | None:
        """Choose the pose of a role whose light says least about the arms: far from the mirror direction.

        None where there is none yet, or it cannot be brought to the centre.
        """
        if not self.rig.stations and wanted is not role:
            return None
        journal = self.store.journal
        poses = {pose.index: pose for pose in journal.poses()}
        shot = {shot.visit for shot in journal.shots() if shot.state is ShotState.VERIFIED}

        def calm(visit: Visit) -> tuple[bool, float]:
            pose = poses[visit.pose]
            half = np.add(pose.wi, pose.wo)
            return bool(visit.flags & ~PoseFlag.NOISY), float(half[2] / np.linalg.norm(half))

        done = [visit for visit in journal.visits() if visit.done and visit.role is wanted]
        return min((visit for visit in done if visit.number in shot), key=calm, default=None)

    def _compare_light(self, visit: Visit, why: str, **detail: Any) -> Messages:
        again = yield from self._again(visit)
        step = again.comparison.ratio(again.before, again.now)
        self._judge(visit, again, step.by_lamp(again.lamp_ratio, self.rig.lamp.u_monitor), why, **detail)

    def _compare_trap(self, visit: Visit, why: str) -> Messages:
        """Compare the stray light, by what the white shows at the same pose."""
        white = [
            each
            for each in self.store.journal.visits()
            if each.done and each.role is Role.WHITE and each.pose == visit.pose
        ]
        if not white or not self._shots(white[0]):
            return
        again = yield from self._again(visit)
        light = self._frames(white[0])
        step = again.comparison.offset(again.before, again.now, light, again.lamp_ratio)
        self._judge(visit, again, step, why)

    def _compare_dark(self, visit: Visit, why: str) -> Messages:
        """Compare frames with the lamp off with those of the first reference, by the light of a pose.

        The first ones are what later ones are compared with.
        """
        journal = self.store.journal
        exposure_s = max(shot.exposure_s for shot in self._shots(visit))
        name = f"{guard_series(self.plan_hash, len(journal.events()))}-1"
        file = yield from self._shoot(name, exposure_s, dark=True)
        known = [event.detail for event in journal.events() if event.kind == REFERENCE]
        first = next(
            (
                detail["files"][0]
                for detail in known
                if detail["role"] == Role.DARK and detail["files"][0]["exposure_s"] == exposure_s
            ),
            file,
        )
        held = self.arms.pose
        if held is None or not (self.store.folder / first["path"]).is_file():
            return
        before, now = (FrameSet((self.store.folder / each["path"],), (exposure_s,)) for each in (first, file))
        comparison = Comparison(self.rig, held.angles_rad, self.sensor)
        step = comparison.offset(before, now, self._frames(visit))
        again = _Again(comparison, Held(held.ticks, held.angles_rad), before, now, (file,))
        self._judge(replace(visit, role=Role.DARK), again, step, why)

    def _again(self, visit: Visit) -> Generator[Msg, Any, _Again]:
        """Go to a pose and shoot its frames once more."""
        journal, shots = self.store.journal, self._shots(visit)
        pose = yield from go(self.arms, PoseGoal(visit.angles_rad, visit.station))
        series = guard_series(self.plan_hash, len(journal.events()))
        files, outputs = [], []
        for shot in shots:
            file = yield from self._shoot(f"{series}-{shot.frame}", shot.exposure_s)
            files.append(file)
            outputs.append(self.camera.lamp_output)
        known = lamp_outputs(self.store.folder, journal)
        times = [shot.exposure_s for shot in shots]
        then, now = (
            float(np.average(values, weights=times))
            for values in ([known.get(shot.shot_id, math.nan) for shot in shots], outputs)
        )
        return _Again(
            Comparison(self.rig, pose.angles_rad, self.sensor),
            Held(pose.ticks, pose.angles_rad),
            self._frames(visit),
            FrameSet(tuple(self.store.folder / file["path"] for file in files), tuple(times)),
            tuple(files),
            lamp_output=now if math.isfinite(now) else None,
            lamp_ratio=now / then if math.isfinite(now / then) else 1.0,
        )

    def _shots(self, visit: Visit) -> list[Shot]:
        shots = self.store.journal.shots(visit.number)
        return [shot for shot in shots if shot.state is ShotState.VERIFIED]

    def _frames(self, visit: Visit) -> FrameSet:
        shots = self._shots(visit)
        files = tuple(self.store.folder / str(shot.path) for shot in shots)
        return FrameSet(files, tuple(shot.exposure_s for shot in shots))

    def _judge(self, visit: Visit, again: _Again, step: Step, why: str, **detail: Any) -> None:
        """Journal a comparison; refuse to go on with what has changed too much."""
        journal = self.store.journal
        beyond = step.beyond(self.tolerance)
        shot_at = [row.time for row in journal.levels() if row.visit == visit.number]
        journal.note(
            REFERENCE,
            why=why,
            role=visit.role,
            pose=visit.pose,
            held_ticks=[visit.held.ticks if visit.held else None, again.held.ticks],
            channels=step.channels,
            ratio=step.ratio,
            u_ratio=step.u_ratio,
            lamp_ratio=again.lamp_ratio,
            lamp_output=again.lamp_output,
            lamp_deg_c=self.lamp_deg_c(),
            since_s=time.time() - seconds_of(shot_at[-1]) if shot_at else None,
            tolerance=self.tolerance,
            accepted=not beyond,
            files=list(again.files),
            **detail,
        )
        name = f"{visit.role} {visit.pose}"
        self.say(f"reference pose, {name}, {why}: {step.told()} of what it was")
        if beyond:
            raise Refused(
                f"the light of the reference pose, {name}, has changed by more than "
                f"{self.tolerance:g}: {step.told()} of what it was",
                where=str(self.store.folder),
                todo="see whether lamp, camera or sample were touched and put them back, accept the step "
                "with --reference-tolerance, or begin a new session",
            )

    def _shoot(
        self, name: str, exposure_s: float, *, dark: bool = False
    ) -> Generator[Msg, Any, dict[str, Any]]:
        """Shoot a frame of its own; return where it lies."""
        picture = yield from shoot(self.camera, Exposure(name, exposure_s, dark=dark), self.store.journal)
        require_same_camera(self.store.journal, self.examiner, picture)
        path, sha256 = self.store.keep_guard(picture, name)
        return {"path": path, "sha256": sha256, "exposure_s": exposure_s}


@dataclass(frozen=True)
class _Again:
    """A pose shot again."""

    comparison: Comparison
    held: Held
    before: FrameSet
    now: FrameSet
    files: tuple[dict[str, Any], ...]
    lamp_output: float | None = None
    lamp_ratio: float = 1.0
