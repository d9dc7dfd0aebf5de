"""A capture from its plan to its session, and on after an interruption.

Everything that can be refused is refused before the machine is opened. The machine's own `with` block makes
it safe on every way out; the journal makes every way out resumable.
"""

from __future__ import annotations

import time
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture.acquire import Acquisition
from capture.bracketing import Objective
from capture.creation import create_session, require_free
from capture.documents import DocumentLog, SafeWait, make_engine
from capture.drift import DriftWatch
from capture.examine import Examiner
from capture.exposure import Chooser, Noise, Shutter, Target
from capture.guards import require_disk, same_exposures, same_plan, same_rig
from capture.interruptions import holes
from capture.itinerary import lay_out
from capture.journal import Journal
from capture.pause import Supervision
from capture.plan import Plan, load_plan
from capture.policy import Patience
from capture.records import Role, ShotState, Visit
from capture.reference import ReferenceGuard
from capture.sensor_doubts import doubts_in_use, require_camera
from capture.session import (
    CALIBRATION_FOLDER,
    DOCUMENTS_FILE,
    JOURNAL_FILE,
    is_complete,
    load_session_sensor,
    read_facts,
)
from capture.steps import cause_of
from capture.store import Store
from capture.wishes import CaptureResult, Wishes
from rig.description import Rig, load_rig
from rig.devices import ArmsDevice, CameraDevice, SupervisionDevice
from rig.errors import GonioError, Refused
from rig.machine import open_machine

if TYPE_CHECKING:
    from capture.sensor import SensorModel
    from capture.statistics import FrameStatistics
    from rig.machine import Machine


def capture(
    plan: Plan | str | Path,
    rig: Rig | str | Path,
    out: str | Path,
    *,
    rig_file: str | Path | None = None,
    wishes: Wishes | None = None,
) -> CaptureResult:
    """Carry out a plan on a machine, into a new session.

    Parameters
    ----------
    plan : Plan or path
    rig : Rig or path
        With the ports to use.
    out : path
        The session's folder; nothing may be there yet.
    rig_file : path, optional
        Where `rig` was read from, if it is not a path: a later resume looks there.
    wishes : Wishes, optional
        Progress, questions, interruption.

    Returns
    -------
    CaptureResult

    Raises
    ------
    BadInput, Refused
        Before anything moves: the plan does not fit the machine, the session exists, the disk is too small.
    GonioError
        From the machine, which is then stopped; the session can be resumed.
    """
    wishes = wishes or Wishes()
    if not isinstance(plan, Plan):
        plan = load_plan(plan)
    if not isinstance(rig, Rig):
        rig_file, rig = rig, load_rig(rig)
    folder = Path(out)
    require_free(folder)
    itinerary = lay_out(plan, rig)
    require_disk(folder, itinerary.forecast().disk_bytes)
    for reason, count in itinerary.feasible.counts.items():
        wishes.say(f"{count} poses are left out: {reason}")
    sensor = _sensor_of(rig.folder, rig)
    examiner = Examiner(rig, sensor)
    with open_machine(rig, inspect=examiner.inspect) as machine:
        wishes.controls.on_abort(machine.stop)
        _tell_doubts(sensor, machine, wishes)
        servos = {row.spec.name: row.as_dict()["found"] for row in machine.handshake.rows}
        create_session(folder, itinerary, rig_file=Path(rig_file) if rig_file else None, servos=servos)
        return _Run(folder, plan, machine, examiner, wishes).carry_out()


def resume(
    session: str | Path,
    *,
    plan: str | Path | None = None,
    rig: str | Path | None = None,
    servos: str | None = None,
    lamp: str | None = None,
    frames: str | Path | None = None,
    reference_tolerance: float | None = None,
    wishes: Wishes | None = None,
) -> CaptureResult:
    """Go on with a session where it ended, however it ended.

    Parameters
    ----------
    session : path
        Its folder.
    plan : path, optional
        A plan that must be the session's.
    rig : path, optional
        The machine's file, if it is no longer where the session was begun from.
    servos, lamp, frames : optional
        Ports and hot folder that replace the file's.
    reference_tolerance : float, optional
        Share by which the light of a reference pose may have changed, instead of the rig file's.
    wishes : Wishes, optional
        Progress, questions, interruption.

    Returns
    -------
    CaptureResult

    Raises
    ------
    BadInput
        It is no session.
    Refused
        Plan, machine or calibration are not the session's, or the light of a reference pose has changed.
    GonioError
        From the machine, which is then stopped; the session can be resumed again.
    """
    wishes = wishes or Wishes()
    folder = Path(session)
    facts = read_facts(folder)
    session_plan = same_plan(folder, facts, plan)
    machine_rig = same_rig(folder, facts, rig, {"servos": servos, "lamp": lamp, "frames": frames})
    same_exposures(folder, facts, Shutter.of(machine_rig).times_s)
    sensor = _sensor_of(folder, machine_rig)
    examiner = Examiner(machine_rig, sensor)
    with open_machine(machine_rig, inspect=examiner.inspect) as machine:
        wishes.controls.on_abort(machine.stop)
        _tell_doubts(sensor, machine, wishes)
        run = _Run(folder, session_plan, machine, examiner, wishes, reference_tolerance=reference_tolerance)
        run.recover()
        return run.carry_out()


def _sensor_of(folder: Path, rig: Rig) -> SensorModel | None:
    """Load the sensor's calibration below a folder, None where there is none; it must be of this camera."""
    sensor = load_session_sensor(folder)
    if sensor is not None:
        require_camera(sensor, rig.camera.serial, None, str(folder / CALIBRATION_FOLDER / "sensor.toml"))
    return sensor


def _tell_doubts(sensor: SensorModel | None, machine: Machine, wishes: Wishes) -> None:
    """Tell what speaks against the sensor's calibration here and now."""
    if sensor is None:
        return
    known = sensor.lamp_temperature_deg_c is not None
    temperature = machine.lamp.temperature_deg_c() if known else None
    for doubt in doubts_in_use(sensor, lamp_temperature_deg_c=temperature):
        wishes.say(doubt)


class _Run:
    """One run of the machine into one session."""

    def __init__(
        self,
        folder: Path,
        plan: Plan,
        machine: Machine,
        examiner: Examiner,
        wishes: Wishes,
        *,
        reference_tolerance: float | None = None,
    ) -> None:
        self.folder, self.plan, self.rig, self.machine = folder, plan, machine.rig, machine
        self.examiner, self.wishes = examiner, wishes
        self.began = time.monotonic()
        self._patience = Patience()
        self._sensor = load_session_sensor(folder)
        self._tolerance = reference_tolerance or machine.rig.supervision.reference_tolerance
        self._unguarded = False
        self._wait = SafeWait(machine.stop)
        self.journal = Journal(folder / JOURNAL_FILE)
        self.store = Store(folder, self.journal)
        machine.on_stray(lambda stray: self.store.set_aside(stray.path, stray.reason))

    def recover(self) -> None:
        """Mend what the last run left."""
        self.store.recover(self.rig.ports.frames, self.examiner.shot_of, self._examine)
        self.journal.note("resumed")
        self._unguarded = True

    def carry_out(self) -> CaptureResult:
        """Do all that is not done; journal how it ended, with light and arms stopped."""
        with closing(self.journal):
            try:
                self._passes()
            except Exception as error:
                cause = cause_of(error)
                self._journal_end(None if self._wait.interrupted else cause)
                if self._wait.interrupted:
                    raise KeyboardInterrupt from None
                if not isinstance(cause, GonioError):
                    raise cause from error
                if self.wishes.controls.abort_requested:
                    return self._result()  # whoever aborted knows why
                todo = self._then_resume(cause.todo)
                raise type(cause)(cause.what, where=cause.where, todo=todo) from error
            self._journal_end(None)
            return self._result()

    def _passes(self) -> None:
        with (
            closing(ArmsDevice(self.machine)) as arms,
            closing(CameraDevice(self.machine)) as camera,
            closing(SupervisionDevice(self.machine)) as levels,
            DocumentLog(self.folder / DOCUMENTS_FILE) as log,
        ):
            engine = make_engine(log, self._wait)
            guard = self._reference(arms, camera, levels)
            supervision = Supervision(
                rig=self.rig,
                device=levels,
                arms=arms,
                darken=self.machine.darken,
                guard=guard,
                journal=self.journal,
                finishing=lambda: self.wishes.controls.finish_requested,
                say=self.wishes.say,
            )
            for role in (Role.WHITE, Role.SAMPLE, Role.TRAP, Role.DARK):
                if role is Role.DARK:
                    self._plan_darks()
                left = [visit for visit in self.journal.visits() if visit.role is role and not visit.done]
                if left and not self._mount(role):
                    return
                if left and role is not Role.DARK and self._unguarded:
                    engine(guard.check(role, "resumed"))
                    self._unguarded = False
                if left:
                    engine(self._acquisition(arms, camera, supervision).run(left, self._metadata(role)))
                if self.wishes.controls.finish_requested:
                    return

    def _reference(self, arms: ArmsDevice, camera: CameraDevice, levels: SupervisionDevice) -> ReferenceGuard:
        return ReferenceGuard(
            rig=self.rig,
            arms=arms,
            camera=camera,
            store=self.store,
            examiner=self.examiner,
            sensor=self._sensor,
            plan_hash=self.plan.hash,
            tolerance=self._tolerance,
            lamp_deg_c=levels.lamp_deg_c,
            say=self.wishes.say,
        )

    def _acquisition(self, arms: ArmsDevice, camera: CameraDevice, supervision: Supervision) -> Acquisition:
        asked = self.plan.exposure
        visits = self.journal.visits()
        darks_to_come = self.plan.darks.count and all(visit.role is not Role.DARK for visit in visits)
        total, done = len(visits) + 2 * bool(darks_to_come), sum(visit.done for visit in visits)

        def visited(visit: Visit) -> None:
            nonlocal done
            done += 1
            self.wishes.progress(done, total, f"{visit.role} {visit.pose}")

        return Acquisition(
            arms=arms,
            camera=camera,
            store=self.store,
            examiner=self.examiner,
            chooser=Chooser(
                Shutter.of(self.rig),
                Target(asked.snr, asked.first_s, asked.max_frames, Objective(asked.spare)),
                Noise.of(self._sensor),
            ),
            plan_hash=self.plan.hash,
            dark_exposures_s=self._dark_exposures_s(),
            dark_count=self.plan.darks.count,
            finishing=lambda: self.wishes.controls.finish_requested,
            visited=visited,
            supervision=supervision,
            drift=DriftWatch(self.plan.references, self.journal),
            patience=self._patience,
            say=self.wishes.say,
        )

    def _plan_darks(self) -> None:
        """Plan the darks, where the arms stand after the last pose, once all others are done."""
        visits = self.journal.visits()
        if not self.plan.darks.count or not visits or any(visit.role is Role.DARK for visit in visits):
            return
        last = visits[-1]
        self.journal.add_visits(
            [
                Visit(last.number + 1 + number, Role.DARK, number, last.station, last.angles_rad)
                for number in range(len(self._dark_exposures_s()))
            ]
        )

    def _dark_exposures_s(self) -> tuple[float, ...]:
        """Shortest and longest exposure used with the lamp on."""
        used = [shot.exposure_s for shot in self.journal.shots() if shot.lit]
        return tuple(sorted({min(used), max(used)})) if used else ()

    def _mount(self, role: Role) -> bool:
        """Have the person mount what a pass needs; False where he stops instead."""
        if self.rig.stations or role is Role.DARK:
            return True
        label = {Role.WHITE: "the white reference", Role.TRAP: "the light trap"}.get(
            role, f"the sample {self.plan.sample}"
        )
        if role not in self.wishes.mounted:
            if self.wishes.mount is None:
                raise Refused(
                    f"nobody can be asked to mount {label}",
                    where=str(self.folder),
                    todo=f"mount it and say so with --mounted {role}",
                )
            self.machine.park()
            if not self.wishes.mount(role, label):
                return False
        self.journal.note("mounted", role=role, label=label)
        return True

    def _metadata(self, role: Role) -> dict[str, Any]:
        return {
            "plan_name": self.plan.name,
            "sample": self.plan.sample,
            "role": role.value,
            "session": self.folder.name,
            "plan_hash": self.plan.hash,
            "rig_hash": self.rig.hash,
        }

    def _examine(self, path: Path, visit: Visit) -> FrameStatistics:
        return self.examiner.statistics(path, visit.held.angles_rad if visit.held else visit.angles_rad)

    def _journal_end(self, error: BaseException | None) -> None:
        """Stop light and arms and journal it all; a journal that cannot take it hides no error."""
        report = self.machine.stop()
        with suppress(GonioError):
            if error is not None:
                self.journal.note("failed", error=str(error))
            else:
                self._journal_outcome()
            self.journal.note("stopped", **report.as_dict())

    def _journal_outcome(self) -> None:
        missing = [hole.as_dict() for hole in holes(self.journal)]
        if is_complete(self.journal, self.plan):
            self.journal.note("finished")
        elif missing and self._nobody_ended_it():
            self.journal.note("incomplete", holes=missing)
        else:
            self.journal.note("interrupted", holes=missing)

    def _nobody_ended_it(self) -> bool:
        controls = self.wishes.controls
        return not (self._wait.interrupted or controls.finish_requested or controls.abort_requested)

    def _then_resume(self, todo: str) -> str:
        resume_it = f"gonio capture --resume {self.folder}"
        return todo if resume_it in todo else f"{todo}; then {resume_it}"

    def _result(self) -> CaptureResult:
        visits = self.journal.visits()
        return CaptureResult(
            session=self.folder,
            complete=is_complete(self.journal, self.plan),
            poses=sum(visit.done and visit.role is Role.SAMPLE for visit in visits),
            frames=sum(shot.state is ShotState.VERIFIED for shot in self.journal.shots()),
            refused=sum(pose.refused is not None for pose in self.journal.poses()),
            flagged=sum(bool(visit.flags) for visit in visits),
            seconds=time.monotonic() - self.began,
            stop=self.machine.stop_report,
            holes=holes(self.journal),
        )
