"""A servo's memory of its own settings, outside its control table: what stays through everything but a store.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", Control Table Backup; X series (firmware 45 and later),
"Backup Ready", "Startup Configuration".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.control_table import Area, StatusError

if TYPE_CHECKING:
    from simulator.registers import Registers

GAINS = (
    "velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain", "position_p_gain",
    "feedforward_2nd_gain", "feedforward_1st_gain",
)  # fmt: skip
RAM_RESTORE = 0x02
"""Bit of `startup_configuration`: the gains come from the backup at power-up."""

_SINCE_FIRMWARE = 45
_STORE, _RESTORE = 1, 2
_KEY = b"CTRL"


class Backup:
    """The backup of one servo; empty at first.

    Parameters
    ----------
    registers : Registers
    """

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._kept: dict[str, int] = {}

    def handle(self, parameters: bytes) -> tuple[StatusError, bool]:
        """Store or restore, as the parameters of the instruction say.

        Returns
        -------
        error : StatusError
            INSTRUCTION (older firmware), DATA_LENGTH, DATA_RANGE (another key or wish), RESULT_FAIL (under
            torque, or nothing is kept).
        restored : bool
            Whether the servo must now restart.
        """
        if self._registers.get("firmware_version") < _SINCE_FIRMWARE:
            return StatusError.INSTRUCTION, False
        if len(parameters) != 1 + len(_KEY):
            return StatusError.DATA_LENGTH, False
        wish = parameters[0]
        if wish not in {_STORE, _RESTORE} or parameters[1:] != _KEY:
            return StatusError.DATA_RANGE, False
        if self._registers.get("torque_enable") or (wish == _RESTORE and not self._kept):
            return StatusError.RESULT_FAIL, False
        if wish == _STORE:
            names = self._registers.of(Area.EEPROM) | set(GAINS)
            self._kept = {name: self._registers.get(name) for name in names}
            self._registers.set("backup_ready", 1)
            return StatusError.NONE, False
        self._write(self._registers.of(Area.EEPROM))
        return StatusError.NONE, True

    def power_up(self) -> None:
        """Say whether something is kept, and bring the gains back where the start-up shall do so."""
        self._registers.set("backup_ready", int(bool(self._kept)))
        if self._registers.get("startup_configuration") & RAM_RESTORE:
            self._write(frozenset(GAINS))

    def _write(self, names: frozenset[str]) -> None:
        for name, value in self._kept.items():
            if name in names:
                self._registers.set(name, value)
