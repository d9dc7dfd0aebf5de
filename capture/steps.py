"""Steps that several plans share: go to a pose, make an exposure, until it holds or its fault stays."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, TypeAlias

from bluesky import plan_stubs
from bluesky.utils import FailedStatus, Msg

from capture.policy import rule_for
from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Generator
    from pathlib import Path

    from capture.examine import Examiner
    from capture.journal import Journal
    from rig.arms import HeldPose
    from rig.devices import ArmsDevice, CameraDevice, PoseGoal
    from rig.devices import Shot as Exposure

    Messages: TypeAlias = Generator[Msg, Any, None]
    """A Bluesky plan."""


def cause_of(error: Exception) -> BaseException:
    """Find the error of a device behind what the engine raises; any other is its own cause."""
    if isinstance(error, FailedStatus) and error.__cause__ is not None:
        return error.__cause__
    return error


def go(arms: ArmsDevice, goal: PoseGoal) -> Generator[Msg, Any, HeldPose]:
    """Move the arms; return where they verifiably stand.

    Raises
    ------
    Refused
        They hold no verified pose.
    """
    yield from plan_stubs.abs_set(arms, goal, wait=True)
    if arms.pose is None:
        raise Refused("the arms hold no verified pose", where=arms.name, todo="run again")
    return arms.pose


def shoot(camera: CameraDevice, exposure: Exposure, journal: Journal) -> Generator[Msg, Any, Path]:
    """Make one exposure and return its picture; a passing fault is tried again under the same name.

    Raises
    ------
    FailedStatus
        The fault stays: its cause is the device's error.
    Refused
        There is no picture.
    """
    for attempt in itertools.count(1):
        yield from plan_stubs.prepare(camera, exposure, wait=True)
        try:
            yield from plan_stubs.trigger(camera, wait=True)
        except FailedStatus as failed:
            error = cause_of(failed)
            rule = rule_for(error)
            if rule is None or attempt >= rule.tries:
                raise
            journal.note("retry", shot_id=exposure.shot_id, attempt=attempt, error=str(error))
        else:
            break
    if camera.path is None:
        raise Refused("the camera has no picture", where=f"shot {exposure.shot_id}", todo="run again")
    return camera.path


def require_same_camera(journal: Journal, examiner: Examiner, picture: Path) -> None:
    """Pass only if a picture is of the camera that made the session's others; the first one decides.

    Raises
    ------
    Refused
        It is of another.
    """
    found, known = examiner.camera(picture), journal.camera()
    if known is None:
        journal.note("camera", serial=found.serial, model=found.model)
    elif known != (found.serial, found.model):
        raise Refused(
            f"the frame is of camera {found.serial} ({found.model}), "
            f"the session's others of {known[0]} ({known[1]})",
            where=str(journal.path.parent),
            todo="connect that camera again, or begin a new session",
        )
