"""The arms of a machine: angles in radians to moves that have verifiably arrived."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rig.approach import comes_from_its_side, lead_ticks
from rig.errors import BadInput, Refused
from rig.ticks import rad_to_ticks, tick_rad, ticks_to_rad

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.description import Joint, Rig
    from rig.servos import Servos


@dataclass(frozen=True, slots=True)
class HeldPose:
    """Where the arms verifiably stand.

    Attributes
    ----------
    ticks : tuple of int
        Measured positions of all servos, in the order of the rig file.
    angles_rad : tuple of float
        Measured angles of `rig.arm_joints`, without the station wheel.
    station : str or None
        Station at the centre; None without a wheel, or where no station stands there.
    """

    ticks: tuple[int, ...]
    angles_rad: tuple[float, ...]
    station: str | None


class Arms:
    """Moves the joints of a machine, in radians.

    Parameters
    ----------
    rig : Rig
    servos : Servos
    stopped : callable
        Whether the machine has been stopped.
    """

    def __init__(self, rig: Rig, servos: Servos, stopped: Callable[[], bool]) -> None:
        self._rig, self._servos, self._stopped = rig, servos, stopped
        self.held: HeldPose | None = None
        """The last verified pose; None before the first move and while moving."""

    def move(
        self,
        angles_rad: Sequence[float],
        station: str | None = None,
        *,
        leading: bool = False,
        slack_rad: float = math.inf,
    ) -> HeldPose:
        """Move all arms together, and the wheel if a station is named; return when they verifiably stand.

        Parameters
        ----------
        angles_rad : sequence of float
            One angle for each of `rig.arm_joints`.
        station : str, optional
            What the wheel brings to the centre; None leaves it as it is.
        leading : bool
            On the way to a pose, as from `lead_in`: the angles need only keep the limits, and the wheel goes
            only to where its own approach begins.
        slack_rad : float
            How far a joint may leave the way that was checked, see `rig.lag`; the wheel is no part of it.

        Raises
        ------
        BadInput
            If there is no such station, or the number of angles is wrong.
        Refused
            If an angle lies outside its limits, or the machine was stopped.
        Unsafe, DeviceLost
            As for `Servos.move`.
        """
        goals = self._goals(angles_rad, station, leading=leading)
        self.held = None
        slack = {joint.id: slack_rad / tick_rad(joint) for joint in self._rig.arm_joints}
        self.held = self._pose(self._servos.move(goals, slack=slack, cancelled=self._stopped))
        return self.held

    def goal(self, angles_rad: Sequence[float], station: str | None = None) -> tuple[float, ...]:
        """Angles that the servos can hold nearest to those asked for; nothing moves.

        Raises
        ------
        BadInput, Refused
            As for `move`.
        """
        goals = self._goals(angles_rad, station)
        return tuple(ticks_to_rad(joint, goals[joint.id]) for joint in self._rig.arm_joints)

    def lead_in(self, angles_rad: Sequence[float], station: str | None = None) -> tuple[float, ...] | None:
        """Where a one-sided approach to a pose begins; None where every joint comes from its side anyway.

        Raises
        ------
        BadInput, Refused
            As for `move`.
        DeviceLost
            If a servo does not answer.
        """
        goals = self._goals(angles_rad, station)
        if all(joint.approach == "direct" for joint in self._rig.joints):
            return None
        present = self._servos.present()
        wrong = [
            joint
            for joint in self._rig.joints
            if joint.id in goals and not comes_from_its_side(joint, present[joint.id], goals[joint.id])
        ]
        if not wrong:
            return None
        ids = {joint.id for joint in wrong}
        return tuple(
            ticks_to_rad(joint, lead_ticks(joint, goals[joint.id]) if joint.id in ids else goals[joint.id])
            for joint in self._rig.arm_joints
        )

    def measure(self) -> HeldPose:
        """Where the arms are now, moving or not.

        Raises
        ------
        DeviceLost
            If a servo does not answer.
        """
        return self._pose(self._servos.present())

    def require_held(self) -> HeldPose:
        """Pass only if the arms stand where the last move left them.

        Raises
        ------
        Refused
            If nothing has been moved to yet.
        Unsafe
            If an arm moves or has left its place.
        """
        held = self.held
        if held is None:
            raise Refused("the arms hold no verified pose", where=self._rig.name, todo="move them first")
        self._servos.require_held(
            {joint.id: ticks for joint, ticks in zip(self._rig.joints, held.ticks, strict=True)}
        )
        return held

    def _goals(
        self, angles_rad: Sequence[float], station: str | None, *, leading: bool = False
    ) -> dict[int, int]:
        joints = self._rig.arm_joints
        if len(angles_rad) != len(joints):
            names = ", ".join(joint.name for joint in joints)
            raise BadInput(f"{len(angles_rad)} angles", where="pose", todo=f"give {len(joints)}: {names}")
        goals = {
            joint.id: _goal_ticks(joint, float(angle), joint.limits_deg if leading else joint.reach_deg)
            for joint, angle in zip(joints, angles_rad, strict=True)
        }
        if station is not None:
            wheel = self._rig.station_joint
            if wheel is None or station not in self._rig.stations:
                known = ", ".join(self._rig.stations) or "none: the machine has no wheel"
                raise BadInput(f"no station {station!r}", where="pose", todo=f"stations are {known}")
            angle_rad = math.radians(self._rig.stations[station].angle_deg)
            ticks = _goal_ticks(wheel, angle_rad, wheel.reach_deg)
            goals[wheel.id] = lead_ticks(wheel, ticks) if leading else ticks
        return goals

    def _pose(self, present: dict[int, int]) -> HeldPose:
        ticks = tuple(present[joint.id] for joint in self._rig.joints)
        angles = tuple(ticks_to_rad(joint, present[joint.id]) for joint in self._rig.arm_joints)
        return HeldPose(ticks, angles, self._station(present))

    def _station(self, present: dict[int, int]) -> str | None:
        wheel = self._rig.station_joint
        if wheel is None:
            return None
        turn_deg = math.degrees(ticks_to_rad(wheel, present[wheel.id]))
        for name, station in self._rig.stations.items():
            if abs(turn_deg - station.angle_deg) <= wheel.tolerance_deg + 0.1:
                return name
        return None


def _goal_ticks(joint: Joint, angle_rad: float, allowed_deg: tuple[float, float]) -> int:
    low, high = allowed_deg
    angle_deg = math.degrees(angle_rad)
    half_a_tick_deg = 0.5 * math.degrees(tick_rad(joint))
    if not low - half_a_tick_deg <= angle_deg <= high + half_a_tick_deg:
        raise Refused(
            f"{joint.name} would go to {angle_deg:.2f} degrees, allowed are {low:g} to {high:g}",
            where="pose",
            todo="choose another pose, or change limits_deg in the rig file if the machine can do it",
        )
    return rad_to_ticks(joint, angle_rad)
