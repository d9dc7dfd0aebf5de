"""The lamp controller's firmware, compiled for this machine, in the place of the twin's lamp."""

from __future__ import annotations

import functools
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from simulator.lamp import Exposure, ShutterMode

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
SKETCH = ROOT / "rig" / "firmware" / "lamp_controller"
MICRO = 1e6
_MODES = (ShutterMode.BULB, ShutterMode.WIDTH, ShutterMode.LAMP)


@functools.cache
def compiled() -> Path:
    """Compile the sketch's core with the tests' board, once; every warning is an error."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("needs g++")
    program = Path(tempfile.mkdtemp(prefix="gonio-firmware-")) / "lamp"
    warnings = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror")
    sources = (str(Path(__file__).with_name("lamp_host.cpp")), str(SKETCH / "lamp_core.cpp"))
    checks = ("-O1", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
    subprocess.run(
        [compiler, "-std=c++11", *checks, *warnings, f"-I{SKETCH}", *sources, "-o", str(program)], check=True
    )
    return program


class FirmwareLamp:
    """Speaks to the compiled firmware as one speaks to `simulator.lamp.Lamp`."""

    def __init__(
        self,
        *,
        on_event: Callable[[str, float, dict[str, object]], None],
        on_exposure: Callable[[Exposure, float], None],
    ) -> None:
        self._on_event, self._on_exposure = on_event, on_exposure
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [compiled()], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="ascii"
        )

    def close(self) -> None:
        """End the program; its sanitizers have the last word."""
        self._process.communicate()
        assert self._process.returncode == 0

    def handle(self, data: bytes, now: float) -> bytes:
        """Bytes arrive; the answers."""
        return self._order(f"R {_micros(now)} {data.hex()}")

    def advance(self, now: float) -> None:
        """Let time pass."""
        self._order(f"P {_micros(now)}")

    def set_interlock(self, closed: bool, now: float) -> None:
        """Close or open the interlock loop."""
        self._order(f"I {_micros(now)} {int(closed)}")

    def dim(self, factor: float) -> None:
        """Let the photodiode see less than the nominal light."""
        self._order(f"D {factor}")

    def _order(self, line: str) -> bytes:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with self._lock:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
            while not (heard := self._process.stdout.readline()).startswith("="):
                self._tell(heard.split())
        return bytes.fromhex(heard[1:])

    def _tell(self, words: list[str]) -> None:
        assert words, "the firmware died"
        event, when = words[0], int(words[1]) / MICRO
        if event == "frame":
            self._on_exposure(_exposure(words[2:], when), when)
        elif event == "light":
            self._on_event(event, when, {"on": words[2] == "1", "level": int(words[3]) / 1e9})
        elif event == "shutter":
            self._on_event(event, when, {"open": words[2] == "1"})
        else:
            self._on_event(event, when, {})


def _exposure(words: list[str], end: float) -> Exposure:
    exposure_us, open_us, lit, level_ppb, mode, shot = map(int, words[:6])
    open_s, exposure_s = open_us / MICRO, exposure_us / MICRO
    light_begin = end - (open_s + exposure_s) / 2.0
    return Exposure(
        exposure_s,
        open_s,
        bool(lit),
        level_ppb / 1e9,
        _MODES[mode],
        words[6] if len(words) > 6 else "",
        shot,
        end - open_s,
        end,
        light_begin if lit else end,
        light_begin + exposure_s if lit else end,
    )


def _micros(time_s: float) -> int:
    return round(time_s * MICRO)
