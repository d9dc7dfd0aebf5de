"""The servos' backup of their own settings, by its packets."""

from __future__ import annotations

import pytest

from rig.control_table import CONTROL_TABLE, StatusError
from simulator.packets import Instruction, PacketReader, packet
from simulator.servo import Servo
from simulator.servo_line import ServoLine

STORE, RESTORE = b"\x01CTRL", b"\x02CTRL"


class Client:
    """One servo and who talks to it."""

    def __init__(self, **eeprom: int) -> None:
        self.servo = Servo(1, eeprom=eeprom)
        self.line = ServoLine([self.servo])

    def ask(self, instruction: int, parameters: bytes) -> int:
        """Return the error of the answer."""
        (answer,) = PacketReader().feed(self.line.handle(packet(1, instruction, parameters), 0.0))
        return answer.parameters[0]  # type: ignore[union-attr]

    def back_up(self, parameters: bytes) -> StatusError:
        return StatusError(self.ask(Instruction.CONTROL_TABLE_BACKUP, parameters))

    def write(self, name: str, value: int) -> None:
        register = CONTROL_TABLE[name]
        assert (
            self.ask(Instruction.WRITE, register.address.to_bytes(2, "little") + register.encode(value)) == 0
        )


def test_the_packets_of_the_manual() -> None:
    """Catches another instruction, key or answer than the manual's, byte for byte."""
    line = ServoLine([Servo(1)])
    # The manual prints 92 F5 as the CRC of the second, a misprint: no servo would take it.
    for asked in ("fffffd0001080020014354524c16f5", "fffffd0001080020024354524c9ef5"):
        assert line.handle(bytes.fromhex(asked), 0.0).hex() == "fffffd000104005500a10c"


def test_what_was_kept_comes_back_with_a_restart() -> None:
    """Catches a store that forgets, a restore of what was not kept, and one without the restart."""
    client = Client()
    client.write("max_position_limit", 3000)
    client.write("position_p_gain", 1234)
    assert client.servo.value("backup_ready") == 0
    assert client.back_up(STORE) is StatusError.NONE
    assert client.servo.value("backup_ready") == 1
    client.write("max_position_limit", 2500)
    client.write("position_p_gain", 500)
    client.write("profile_velocity", 40)
    assert client.back_up(RESTORE) is StatusError.NONE
    assert client.servo.value("max_position_limit") == 3000
    assert client.servo.value("profile_velocity") == 0  # it has restarted
    assert client.servo.value("position_p_gain") == 900  # gains only where the start-up shall bring them back
    assert client.servo.value("backup_ready") == 1


@pytest.mark.parametrize(("startup", "gain"), [(0, 900), (2, 1234)])
def test_gains_come_back_at_power_up_where_they_shall(startup: int, gain: int) -> None:
    """Catches gains that are lost though the start-up asks for them, or brought back though it does not."""
    client = Client(startup_configuration=startup)
    client.write("position_p_gain", 1234)
    assert client.back_up(STORE) is StatusError.NONE
    client.servo.factory_reset(0x02, 0.0)
    client.write("startup_configuration", startup)
    client.servo.reboot(0.0)
    assert client.servo.value("position_p_gain") == gain


@pytest.mark.parametrize(
    ("parameters", "torque", "firmware", "error"),
    [
        (STORE, 1, 45, StatusError.RESULT_FAIL),
        (RESTORE, 0, 45, StatusError.RESULT_FAIL),
        (b"\x03CTRL", 0, 45, StatusError.DATA_RANGE),
        (b"\x01CTRX", 0, 45, StatusError.DATA_RANGE),
        (b"\x01CTR", 0, 45, StatusError.DATA_LENGTH),
        (STORE, 0, 44, StatusError.INSTRUCTION),
    ],
)
def test_what_it_refuses(parameters: bytes, torque: int, firmware: int, error: StatusError) -> None:
    """Catches a backup under torque, of nothing, with another key, or on firmware that has none."""
    client = Client(firmware_version=firmware)
    client.write("torque_enable", torque)
    assert client.back_up(parameters) is error
    assert client.servo.value("backup_ready") == 0
