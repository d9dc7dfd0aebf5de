"""The measurement as a Bluesky plan: go to a pose, shoot until it has what it needs, next.

The engine gives runs, documents and the order of things; what must outlive the process is in the journal, and
every decision is taken from there.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from bluesky import plan_stubs
from bluesky.utils import FailedStatus, Msg

from capture.drift import Moment
from capture.exposure import Chooser, Observation
from capture.interruptions import SKIPPED
from capture.records import NO_FLAG, Held, PoseFlag, Role, Shot, ShotState, Visit
from capture.steps import cause_of, go, require_same_camera, shoot
from capture.store import Store, shot_id
from rig.devices import ArmsDevice, CameraDevice, PoseGoal
from rig.devices import Shot as Exposure
from rig.errors import GonioError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from pathlib import Path

    from capture.drift import DriftWatch
    from capture.examine import Examiner
    from capture.journal import Journal
    from capture.pause import Supervision
    from capture.policy import Patience
    from capture.steps import Messages
    from rig.arms import HeldPose

PRIMARY = "primary"


@dataclass(frozen=True)
class Acquisition:
    """Everything that the plan needs.

    Attributes
    ----------
    arms, camera
        The machine's devices.
    store : Store
        Where frames go.
    examiner : Examiner
        What frames show.
    chooser : Chooser
        Which exposure comes next.
    plan_hash : str
        Of the measurement's plan; it begins the names of the shots.
    dark_exposures_s : tuple of float
        Exposures of the darks: shortest, longest.
    dark_count : int
        Dark frames at each.
    finishing : callable
        Asked after each frame; true ends the plan there.
    visited : callable
        Told of each visit that is done.
    supervision : Supervision
        Looks at the levels, and pauses.
    drift : DriftWatch
        Says when a reference is due.
    patience : Patience
        How many poses in a row may be skipped.
    say : callable
        Told in one line what a person should know.
    """

    arms: ArmsDevice
    camera: CameraDevice
    store: Store
    examiner: Examiner
    chooser: Chooser
    plan_hash: str
    dark_exposures_s: tuple[float, ...]
    dark_count: int
    finishing: Callable[[], bool]
    visited: Callable[[Visit], None]
    supervision: Supervision
    drift: DriftWatch
    patience: Patience
    say: Callable[[str], None]

    @property
    def journal(self) -> Journal:
        """The session's journal."""
        return self.store.journal

    def run(self, visits: Sequence[Visit], metadata: dict[str, Any]) -> Messages:
        """Plan one run over some visits, in their order; those that were skipped come once more at the end.

        Parameters
        ----------
        visits : sequence of Visit
            Those that are not done yet.
        metadata : dict
            For the start document.

        Yields
        ------
        Msg
        """
        yield from plan_stubs.open_run(metadata)
        skipped = yield from self._round(visits)
        if skipped:
            yield from self._round(skipped)
        yield from plan_stubs.close_run()

    def _round(self, visits: Sequence[Visit]) -> Generator[Msg, Any, list[Visit]]:
        """Go to some visits; return those that had to be skipped."""
        skipped = []
        for visit in visits:
            if self.finishing():
                break
            try:
                if (yield from self.supervision.keep(visit.role)) and self.finishing():
                    break
                yield from self._refresh(visit.role)
                yield from self._visit(visit)
            except (GonioError, FailedStatus) as error:
                cause = cause_of(error)
                if not self.patience.may_skip(cause):
                    raise
                self._skip(visit, cause)
                skipped += self.journal.visits(visit.number)
            else:
                self.patience.regain()
        return skipped

    def _refresh(self, role: Role) -> Messages:
        """Shoot references where drift asks for them: what it would spoil is yet to come."""
        levels = self.supervision.device.levels
        if levels is None or role is Role.DARK:
            return
        due = self.drift.due(Moment(time.time(), levels.lamp_output, levels.lamp_deg_c))
        if due is not None:
            why, prediction = due
            yield from self.supervision.guard.refresh(role, why, asdict(prediction))
            self.drift.learn()

    def _skip(self, visit: Visit, cause: BaseException) -> None:
        self.journal.note(SKIPPED, visit=visit.number, role=visit.role, pose=visit.pose, error=str(cause))
        self.say(f"{visit.role} {visit.pose} is skipped: {cause}")

    def _visit(self, visit: Visit) -> Messages:
        held = yield from self._go(visit)
        history = _observations(self.journal.shots(visit.number))
        previous = self._previous(visit)
        while (exposure_s := self._next_exposure(visit, history, previous)) is not None:
            shot = self._intend(visit, len(history) + 1, exposure_s)
            exposure = Exposure(shot.shot_id, shot.exposure_s, dark=not shot.lit)
            picture = yield from shoot(self.camera, exposure, self.journal)
            history.append(self._take(shot, visit, held, picture))
            yield from self._record()
            if self.finishing():
                break
            if (yield from self.supervision.keep(visit.role)):
                if not self.finishing():
                    yield from self._visit(*self.journal.visits(visit.number))
                return
        if self._next_exposure(visit, history, previous) is None:
            self.supervision.log(visit)
            self.journal.finish(visit.number, self._flags(visit, history))
            self.visited(visit)

    def _go(self, visit: Visit) -> Generator[Msg, Any, Held]:
        pose = yield from go(self.arms, PoseGoal(visit.angles_rad, visit.station))
        return self._hold(visit, pose)

    def _hold(self, visit: Visit, pose: HeldPose) -> Held:
        """Journal where the arms stand; frames of the same pose from elsewhere are set aside."""
        held = Held(pose.ticks, pose.angles_rad)
        if visit.held == held:
            return held
        taken = [shot for shot in self.journal.shots(visit.number) if shot.path is not None]
        if visit.held is not None and taken:
            self.journal.note(
                "moved", role=visit.role, pose=visit.pose, before=visit.held.ticks, now=held.ticks
            )
            for shot in taken:
                path = self.store.folder / (shot.path or "")
                self.store.set_aside(path, f"of shot {shot.shot_id}: the arms stand elsewhere now")
            self.journal.reopen(visit.number)
        self.journal.hold(visit.number, held)
        return held

    def _previous(self, visit: Visit) -> list[Observation]:
        """Frames of the visit before, if that was in the same role."""
        before = self.journal.visits(visit.number - 1)
        if not before or before[0].role is not visit.role:
            return []
        return _observations(self.journal.shots(visit.number - 1))

    def _next_exposure(
        self, visit: Visit, history: Sequence[Observation], previous: Sequence[Observation]
    ) -> float | None:
        if visit.role is Role.DARK:
            return self.dark_exposures_s[visit.pose] if len(history) < self.dark_count else None
        if visit.role is Role.TRAP:
            return self._next_of_trap(visit, history)
        return self.chooser.next_exposure(history, previous)

    def _next_of_trap(self, visit: Visit, history: Sequence[Observation]) -> float | None:
        """Longest exposure that the pose has had: stray light is then known better than what it is taken off.

        Shorter ones follow while something clips: a lamp that is seen, a reflex.
        """
        if history and not history[-1].clipped:
            return None
        lit = {other.number for other in self.journal.visits() if other.pose == visit.pose} - {visit.number}
        used = {
            shot.exposure_s
            for shot in self.journal.shots()
            if shot.lit and shot.visit in lit and shot.state is ShotState.VERIFIED
        }
        return max(used - {seen.exposure_s for seen in history}, default=None)

    def _flags(self, visit: Visit, history: Sequence[Observation]) -> PoseFlag:
        if visit.role is Role.DARK:
            return NO_FLAG
        if visit.role is Role.TRAP:  # it is dark on purpose
            return PoseFlag.OVER_RANGE if history and all(seen.clipped for seen in history) else NO_FLAG
        return self.chooser.flags(history)

    def _intend(self, visit: Visit, frame: int, exposure_s: float) -> Shot:
        name = shot_id(self.plan_hash, visit.role, visit.pose, frame)
        shot = Shot(name, visit.number, frame, exposure_s, lit=visit.role is not Role.DARK)
        self.journal.intend(shot)
        return shot

    def _take(self, shot: Shot, visit: Visit, held: Held, arrived: Path) -> Observation:
        require_same_camera(self.journal, self.examiner, arrived)
        statistics = self.examiner.statistics(arrived, held.angles_rad)
        self.store.take(shot, visit, arrived, statistics)
        return Observation(shot.exposure_s, statistics)

    def _record(self) -> Messages:
        """One event document: where the arms were, what was shot."""
        yield from plan_stubs.create(name=PRIMARY)
        yield from plan_stubs.read(self.arms)
        yield from plan_stubs.read(self.camera)
        yield from plan_stubs.read(self.supervision.device)
        yield from plan_stubs.save()


def _observations(shots: Sequence[Shot]) -> list[Observation]:
    return [
        Observation(shot.exposure_s, shot.statistics)
        for shot in shots
        if shot.state is ShotState.VERIFIED and shot.statistics is not None
    ]
