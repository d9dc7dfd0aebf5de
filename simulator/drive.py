"""What moves a servo's shaft: its mode, goal and gains, the frame it counts in, and the effort that it takes.

Source: ROBOTIS e-manual, X series, "Operating Mode", "Goal Position", "Homing Offset", "Drive Mode".
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rig.control_table import DriveMode, OperatingMode
from simulator.backup import GAINS
from simulator.motion import Motion, turn_at
from simulator.profile import Profile
from simulator.servo_body import Body
from simulator.servo_rules import GOALS, POSITION_MODES
from simulator.shaft import Flaws, Shaft, nearest

if TYPE_CHECKING:
    from rig.servo_models import ModelInfo
    from simulator.registers import Registers

TICKS_PER_TURN = 4096

_HOMING_LIMIT_IN_ONE_TURN = 1024
_PROFILE = ("profile_velocity", "profile_acceleration")
_GAIN_UNIT = 128.0
_FULL_PWM = 885.0


class Drive:
    """Motor, shaft and position counter of one servo.

    Parameters
    ----------
    model : ModelInfo
    registers : Registers
        Goals, gains, mode and frame; the goals that it sets itself it writes there.
    flaws : Flaws
    shaft_ticks : float
        Where the shaft stands.
    speed : float
        How many times faster than the clock it moves and warms.
    now : float
        Seconds of the clock.

    Attributes
    ----------
    shaft : Shaft
    body : Body
    profile : Profile
    saturated_since : float or None
        Since when it has given all it has; None while it has not.
    """

    def __init__(
        self,
        model: ModelInfo,
        registers: Registers,
        flaws: Flaws,
        *,
        shaft_ticks: float,
        speed: float,
        now: float,
    ) -> None:
        self._model, self._registers, self._flaws = model, registers, flaws
        self.profile = Profile(model, registers)
        self.shaft = Shaft(shaft_ticks, speed=speed, now=now)
        self.body = Body(model.supply_v, model.stall_a, now=now, speed=speed)
        self._counted_turns = 0
        self._wanted = shaft_ticks
        self.saturated_since: float | None = None

    # -- where it is

    def present_ticks(self, now: float) -> int:
        """Position as the servo reports it."""
        return nearest(self.reported(self.shaft.at(now)[0]))

    def moving(self, now: float) -> bool:
        """Tell whether a profile is running or the shaft turns faster than the moving threshold."""
        speed = abs(self.shaft.at(now)[1]) / self.profile.velocity_unit
        return self.shaft.running(now) or speed > self._registers.get("moving_threshold")

    def behind_ticks(self) -> float:
        """How far the arm hangs from where the encoder sees the shaft."""
        return self.shaft.behind_ticks(self._flaws.backlash_ticks)

    def halt(self, now: float) -> None:
        """Stand still at once, and want nothing else."""
        self.live(now)
        self.shaft.halt(now)
        self._wanted = self.shaft.at(now)[0]

    def hinder(self, factor: float, now: float, until: float) -> None:
        """Let something hold the shaft, against which the motor pushes on."""
        self.live(now)
        self.shaft.hinder(factor, now, until)

    def carry(self, shaft_ticks: float, now: float) -> None:
        """Let a hand bring the shaft somewhere."""
        self.live(now)
        self.shaft.start(Motion(shaft_ticks), now)
        self.halt(now)

    def lose_turn(self, now: float) -> None:
        """Let the count of turns be off by one; in position mode, of one turn, there is nothing to lose."""
        if self._mode != OperatingMode.POSITION:
            self._counted_turns += 1
            self._adopt(now)

    # -- frames

    @property
    def _mode(self) -> int:
        return self._registers.get("operating_mode")

    @property
    def direction(self) -> int:
        """Whether larger ticks are reported for larger ticks of the shaft, 1, or for smaller ones, -1."""
        return -1 if self._registers.get("drive_mode") & DriveMode.REVERSE else 1

    @property
    def _offset_ticks(self) -> int:
        offset = self._registers.get("homing_offset")
        one_turn = self._mode == OperatingMode.POSITION
        ignored = one_turn and abs(offset) > _HOMING_LIMIT_IN_ONE_TURN
        return (0 if ignored else offset) + self._counted_turns * TICKS_PER_TURN

    def reported(self, shaft: float) -> float:
        """Place of the shaft as the servo counts it."""
        return self.direction * shaft + self._offset_ticks

    def _to_shaft(self, reported: float) -> float:
        return self.direction * (reported - self._offset_ticks)

    def power_up(self, now: float) -> None:
        """Start anew: the count of turns is lost, and the goal is where the shaft is."""
        self._forget_turns(now)
        self._adopt(now)

    def _adopt(self, now: float) -> None:
        """Let the goal be where the shaft is: nothing jumps."""
        self._registers.set("goal_position", self.present_ticks(now))

    def _forget_turns(self, now: float) -> None:
        self._counted_turns = 0
        self._counted_turns = -(self.present_ticks(now) // TICKS_PER_TURN)

    # -- what follows a write

    def after_torque(self, value: int, now: float) -> None:
        """Hold the place, or let it go; goals from before are forgotten, so that nothing jumps."""
        self.halt(now)
        if value and self._mode == OperatingMode.POSITION:
            self._forget_turns(now)
        self._adopt(now)
        self._registers.set("goal_velocity", 0)
        if self._mode == OperatingMode.PWM:
            self._registers.set("goal_pwm", 0)
        if self._mode == OperatingMode.CURRENT:
            self._registers.set("goal_current", 0)

    def after_goal_position(self, _value: int, now: float) -> None:
        """Set out for the goal, where there is torque."""
        if self._mode in POSITION_MODES and self._registers.get("torque_enable"):
            self._wanted = self._to_shaft(self._registers.get("goal_position"))
            self._set_out(now)

    def _set_out(self, now: float) -> None:
        """Make for the place wanted, as far as friction lets it come."""
        position = self.shaft.at(now)[0]
        way = self._wanted - position
        way -= math.copysign(min(self._steady_error_ticks(), abs(way)), way)
        limits, kind = self.profile.limits(way)
        self.shaft.go(position + way, limits, kind, now)

    def _steady_error_ticks(self) -> float:
        if not self._flaws.steady_error_ticks or self._registers.get("position_i_gain"):
            return 0.0
        usual = self._registers.default("position_p_gain")
        return self._flaws.steady_error_ticks * usual / max(self._registers.get("position_p_gain"), 1)

    def after_goal_velocity(self, value: int, now: float) -> None:
        """Turn, in velocity mode."""
        if self._mode == OperatingMode.VELOCITY:
            self._turn(value * self.profile.velocity_unit, now)

    def after_goal_pwm(self, value: int, now: float) -> None:
        """Turn, in PWM mode, as fast as the motor does without load."""
        if self._mode == OperatingMode.PWM:
            self._turn(self.profile.motor * value / _FULL_PWM, now)

    def after_goal_current(self, value: int, now: float) -> None:
        """Turn at full speed at any current above friction: a light arm has nothing to push against."""
        if self._mode == OperatingMode.CURRENT:
            unit_a = (self._model.current_unit_ma or 0.0) / 1000.0
            turns = abs(value) * unit_a / self._model.stall_a > self.body.friction
            self._turn(math.copysign(self.profile.motor, value) if turns else 0.0, now)

    def _turn(self, velocity: float, now: float) -> None:
        if self._registers.get("torque_enable"):
            goal = self.direction * velocity * self.shaft.freedom(now)
            self.shaft.start(turn_at(goal, *self.shaft.at(now), self.profile.acceleration()), now)

    def after_mode(self, _value: int, now: float) -> None:
        """Forget turns, gains, profile and what limits the output: a switch of the mode resets them."""
        self._forget_turns(now)
        for name in (*GAINS, *_PROFILE):
            self._registers.set(name, self._registers.default(name))
        for goal in set(GOALS) & self._registers.names - {"goal_position"}:
            self._registers.set(goal, self._registers.default(goal))
        self._adopt(now)

    def after_frame_change(self, _value: int, now: float) -> None:
        """Count from another place or the other way round; nothing moves."""
        if self._mode == OperatingMode.POSITION:
            self._forget_turns(now)
        self._adopt(now)

    def stop_for_silence(self, now: float) -> None:
        """Stop because the bus is silent; the profile is forgotten.

        In extended mode with a homing offset the motor runs away instead (DynamixelSDK issue 584).
        """
        self.halt(now)
        for name in _PROFILE:
            self._registers.set(name, 0)
        if self._mode == OperatingMode.EXTENDED_POSITION and self._registers.get("homing_offset"):
            self._turn(self.profile.motor, now)

    # -- time

    def go_on(self, now: float) -> None:
        """Set out again for the goal where something had held the shaft and let go; then live until now."""
        released = self.shaft.released(now)
        if released is not None and not self.shaft.running(now):
            self.live(released)
            self._set_out(released)
        self.live(now)

    def live(self, now: float) -> None:
        """Grow warm or cool: until the motion's end as it moves, and from there as it holds."""
        for end in (min(now, self.shaft.end), now):
            begin = self.body.lived_until
            if end > begin:
                effort = abs(self.effort(begin))
                self.saturated_since = (self.saturated_since or begin) if effort >= 1.0 else None
                self.body.live(end, effort)

    def effort(self, now: float) -> float:
        """Share of the full effort, -1 to 1, positive where it pushes towards larger shaft ticks."""
        if not self._registers.get("torque_enable"):
            return 0.0
        pressed = self.body.pressed(now)
        if self.shaft.running(now):
            return math.copysign(min(self.body.friction + pressed, 1.0), self.shaft.at(now)[1])
        error = self._wanted - self.shaft.at(now)[0] if self._mode in POSITION_MODES else 0.0
        output = error * self._registers.get("position_p_gain") / _GAIN_UNIT / _FULL_PWM
        return max(min(output + math.copysign(pressed, output), 1.0), -1.0)
