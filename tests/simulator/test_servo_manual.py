"""The packets that the maker's manual prints as examples, byte for byte.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", Instruction Details. Its servos are two XM430-W210 with
firmware 38 at the positions 166 and 2079.
"""

from __future__ import annotations

import pytest

from simulator.servo import Servo
from simulator.servo_line import ServoLine

CASES = {
    "ping": ("FFFFFD0001030001194E", "FFFFFD00010700550006042665 5D"),
    "broadcast ping": (
        "FFFFFD00FE0300013142",
        "FFFFFD000107005500060426655D FFFFFD0002070055000604266F6D",
    ),
    "read": ("FFFFFD000107000284000400 1D15", "FFFFFD000108005500A60000008CC0"),
    "write": ("FFFFFD0001090003740000020000CA89", "FFFFFD0001040055 00A10C"),
    "reg write": ("FFFFFD00010900046800C8000000AE8E", "FFFFFD000104005500A10C"),
    "factory reset": ("FFFFFD000104000601A1E6", "FFFFFD000104005500A10C"),
    "reboot": ("FFFFFD00010300082F4E", "FFFFFD000104005500A10C"),
    "clear": ("FFFFFD00010800100144584C22B1DC", "FFFFFD000104005500A10C"),
    "sync read": (
        "FFFFFD00FE09008284000400 0102CEFA",
        "FFFFFD000108005500A60000008CC0 FFFFFD0002080055001F080000BABE",
    ),
    "sync write": ("FFFFFD00FE1100837400040001960000 0002AA0000008287", ""),
    "bulk read": (
        "FFFFFD00FE0D0092019000020002920001001A05",
        "FFFFFD000106005500 7700C369 FFFFFD00020500550024 8BA9",
    ),
}


@pytest.fixture
def line() -> ServoLine:
    """Return the manual's two servos."""
    servos = [
        Servo(i, "XM430-W210", shaft_ticks=ticks, eeprom={"firmware_version": 38})
        for i, ticks in ((1, 166), (2, 2079))
    ]
    servos[0].weaken_supply(0.992, 0.0, 1e9)  # its first servo reads 11.9 V
    servos[1].heat(36.0, 0.0)  # its second one 36 degrees
    return ServoLine(servos)


@pytest.mark.parametrize("name", CASES)
def test_an_example_of_the_manual(line: ServoLine, name: str) -> None:
    """Catches an answer that a client written from the manual does not understand."""
    asked, answered = (bytes.fromhex(text) for text in CASES[name])
    assert line.handle(asked, 0.0).hex() == answered.hex()


def test_action_follows_the_manuals_reg_write(line: ServoLine) -> None:
    """Catches a registered write that the manual's action does not execute."""
    line.handle(bytes.fromhex(CASES["reg write"][0]), 0.0)
    assert line.handle(bytes.fromhex("FFFFFD000103000502CE"), 0.0).hex() == "fffffd000104005500a10c"
    assert line.servos[0].value("goal_velocity") == 200
