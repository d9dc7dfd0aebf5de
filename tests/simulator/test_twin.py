"""The twin from outside: a process that a plain client finds on two ports and a folder."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import serial
from dynamixel_sdk import GroupSyncRead, PacketHandler, PortHandler

from rig.errors import BadInput, Refused
from simulator.truth import residual_ticks, station_at, true_angles_rad

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rig.description import Rig
    from simulator.twin import Twin

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals as Linux has them")

TORQUE, GOAL, MOVING, PRESENT = 64, 116, 122, 132


class PatientPort(PortHandler):
    """The SDK's port, but for its deadline of 34 ms, in which a busy test machine may not get to us."""

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802 - the SDK's name
        """Wait for half a minute, whatever the length."""
        self.setPacketTimeoutMillis(30_000.0)


class Servos:
    """A client that uses nothing but the maker's SDK."""

    def __init__(self, twin: Twin) -> None:
        self.port, self.sdk = PatientPort(twin.servos), PacketHandler(2.0)
        assert self.port.openPort()
        assert self.port.setBaudRate(twin.baud)

    def move(self, goals: dict[int, int]) -> None:
        """Move and wait."""
        for servo_id, goal in goals.items():
            assert self.sdk.write1ByteTxRx(self.port, servo_id, TORQUE, 1) == (0, 0)
            assert self.sdk.write4ByteTxRx(self.port, servo_id, GOAL, goal) == (0, 0)
        deadline = time.monotonic() + 60.0
        while any(self.sdk.read1ByteTxRx(self.port, i, MOVING)[0] for i in goals):
            assert time.monotonic() < deadline

    def positions(self, ids: list[int]) -> list[int]:
        """Read all positions at once."""
        read = GroupSyncRead(self.port, self.sdk, PRESENT, 4)
        for servo_id in ids:
            assert read.addParam(servo_id)
        assert read.txRxPacket() == 0
        return [read.getData(servo_id, PRESENT, 4) for servo_id in ids]


class LampLine:
    """A client that uses nothing but pyserial."""

    def __init__(self, twin: Twin) -> None:
        self.port = serial.Serial(twin.lamp, 115_200, timeout=30.0)

    def say(self, *lines: str) -> None:
        """Send commands."""
        self.port.write("".join(f"{line}\n" for line in lines).encode())

    def ask(self, query: str) -> str:
        """Send a query; its answer."""
        self.say(query)
        return self.port.readline().decode().strip()

    def expose(self, twin: Twin, shot_id: str, command: str = "SHUT:EXP 0.02") -> Path:
        """Make one exposure; the file, when it is complete."""
        before = set(Path(twin.frames).glob("*.dng"))
        done = int(self.ask("SHUT?").split(",")[1])
        self.say(f"SHUT:ID {shot_id}", command)
        deadline = time.monotonic() + 60.0
        while self.ask("SHUT?") != f"IDLE,{done + 1},{shot_id}":
            assert time.monotonic() < deadline
        while not (new := set(Path(twin.frames).glob("*.dng")) - before):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert self.ask("SYST:ERR?") == '0,"No error"'
        return new.pop()


@pytest.fixture
def clients(twin: Callable[..., Twin]) -> Iterator[tuple[Twin, Servos, LampLine]]:
    """Open both ports of a running twin."""
    running = twin({"sample1": "lambert:kd=0.5"}, seed=5, speed=20.0)
    servos, lamp = Servos(running), LampLine(running)
    yield running, servos, lamp
    lamp.say("*RST")
    lamp.port.close()
    servos.port.closePort()


@pytest.mark.render
def test_a_plain_script_moves_the_arms_and_gets_a_raw_file(clients: tuple[Twin, Servos, LampLine]) -> None:
    """Catches a twin that only our own driver can use: ping, torque, move all five, expose, open the file."""
    import rawpy

    twin, servos, lamp = clients
    for servo_id in twin.ids:
        assert servos.sdk.ping(servos.port, servo_id) == (1000, 0, 0)
    found, result = servos.sdk.broadcastPing(servos.port)
    assert (sorted(found), result) == (twin.ids, 0)
    goals = {1: 1600, 2: 2300, 3: 2400, 4: 1900, 5: 2048 + 1638}
    servos.move(goals)
    assert servos.positions(twin.ids) == list(goals.values())
    lamp.say("OUTP ON")
    path = lamp.expose(twin, "plain-1")
    with rawpy.imread(str(path)) as raw:
        assert raw.raw_image.shape == (96, 128)
    frame = [event for event in twin.wire_log() if event.get("event") == "exposed"][-1]
    assert (frame["id"], frame["moved"]) == ("plain-1", False)
    assert list(frame["ticks"].values()) == list(goals.values())


@pytest.mark.render
def test_the_same_shot_is_the_same_frame(clients: tuple[Twin, Servos, LampLine]) -> None:
    """Catches frames that depend on time or on earlier shots: a resumed session would not repeat."""
    twin, servos, lamp = clients
    lamp.say("OUTP ON")
    servos.move({1: 1700, 5: 2048})
    first = lamp.expose(twin, "again")
    servos.move({1: 2500})
    other = lamp.expose(twin, "other")
    servos.move({1: 1700})
    second, noise = lamp.expose(twin, "again"), lamp.expose(twin, "noise")
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (first, second, noise, other)]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3


@pytest.mark.render
def test_an_aborted_exposure_makes_no_file(clients: tuple[Twin, Servos, LampLine]) -> None:
    """Catches a file that arrives although the light went off in the middle."""
    twin, _, lamp = clients
    before = len(list(Path(twin.frames).iterdir()))
    lamp.say("OUTP ON", "SHUT:EXP 100")
    assert lamp.ask("SHUT?").startswith("BUSY")
    lamp.say("OUTP OFF")
    assert lamp.ask("SHUT?").startswith("IDLE")
    lamp.expose(twin, "after", "SHUT:DARK 0.01")
    assert len(list(Path(twin.frames).iterdir())) == before + 1


def children(pid: int) -> list[int]:
    """List the processes that a process has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(") ")[2].split()[1]) == pid:
                found.append(int(stat.parent.name))
    return found


def test_replies_do_not_wait_for_frames(clients: tuple[Twin, Servos, LampLine]) -> None:
    """Catches rendering in the wires' own loop: here it takes for ever, and only the folder may notice."""
    twin, servos, lamp = clients
    frames = len(list(Path(twin.frames).iterdir()))
    (light,) = children(twin.pid)
    os.kill(light, signal.SIGSTOP)
    try:
        for shot in range(200):
            lamp.say(f"SHUT:ID stopped-{shot}", "SHUT:DARK 0.001")
            assert servos.sdk.ping(servos.port, 1 + shot % 5) == (1000, 0, 0)
            while lamp.ask("SHUT?").startswith("BUSY"):
                pass
        assert len(list(Path(twin.frames).iterdir())) == frames
    finally:
        os.kill(light, signal.SIGCONT)
    deadline = time.monotonic() + 60.0
    while len(list(Path(twin.frames).glob("*.dng"))) < frames + 200:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_the_log_tells_what_went_over_the_wire(clients: tuple[Twin, Servos, LampLine]) -> None:
    """Catches a log that is late, out of order, or without the light: stop paths are proved with it."""
    twin, servos, lamp = clients
    servos.sdk.ping(servos.port, 3)
    lamp.say("OUTP ON", "OUTP OFF")
    assert lamp.ask("OUTP?") == "0"
    log = twin.wire_log()
    pings = [e for e in log if e["line"] == "servos" and e["data"].startswith("fffffd00030300")]
    assert pings[-1]["direction"] == "in"
    said = bytes.fromhex("".join(e["data"] for e in log if e["line"] == "lamp" and e["direction"] == "in"))
    assert said.endswith(b"OUTP ON\nOUTP OFF\nOUTP?\n")
    light = [e["on"] for e in log if e.get("event") == "light"]
    assert light[-2:] == [True, False]
    times = [e["t"] for e in log]
    assert times == sorted(times)
    assert times[-1] <= time.monotonic()


def test_a_killed_client_is_followed_by_another(clients: tuple[Twin, Servos, LampLine]) -> None:
    """Catches ports that stay busy, or a half packet that spoils the next client's first one."""
    twin, servos, lamp = clients
    servos.port.closePort()
    lamp.port.close()
    script = (
        "import sys, time, fcntl, termios, serial\n"
        "ports = [serial.Serial(path, 115200, exclusive=True) for path in sys.argv[1:]]\n"
        "[fcntl.ioctl(port.fd, termios.TIOCEXCL) for port in ports]\n"
        "ports[0].write(bytes.fromhex('fffffd000109000374')); ports[1].write(b'SHUT:EX')\n"
        "print('open', flush=True); time.sleep(60)\n"
    )
    for _ in range(3):
        command = [sys.executable, "-c", script, twin.servos, twin.lamp]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as client:
            assert client.stdout is not None
            assert client.stdout.readline() == "open\n"
            client.kill()
    time.sleep(0.02)  # as long as a program takes to start
    servos.port.openPort()
    assert servos.sdk.ping(servos.port, 1) == (1000, 0, 0)
    again = LampLine(twin)
    assert again.ask("*IDN?").startswith("gonio,lamp,")
    again.port.close()
    lamp.port.open()


def is_running(pid: int) -> bool:
    """Tell whether a process runs; one that only waits to be reaped does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2]
    except OSError:
        return False
    return not state.startswith("Z")


def test_it_ends_with_whoever_started_it() -> None:
    """Catches twins that outlive a killed test run and render for ever."""
    script = "from simulator.twin import Twin\nwith Twin() as t: print(t.pid, t.folder, flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as starter:
        assert starter.stdout is not None
        pid, folder = starter.stdout.readline().split()
        starter.kill()
    deadline = time.monotonic() + 60.0
    while is_running(int(pid)) or Path(folder).exists():
        assert time.monotonic() < deadline, "the twin is still there"
        time.sleep(0.02)


def test_a_folder_serves_one_twin(tmp_path: Path) -> None:
    """Catches a second twin that takes the ports of the first, and a dead one that keeps its folder."""
    from simulator.twin import Twin

    with Twin(folder=tmp_path, log=False) as first:
        ports = [Path(port).resolve() for port in (first.servos, first.lamp)]
        with pytest.raises(Refused, match="another twin serves there"), Twin(folder=tmp_path):
            pass
        assert [Path(port).resolve() for port in (first.servos, first.lamp)] == ports
        os.kill(first.pid, signal.SIGKILL)
        first.close()
    with Twin(folder=tmp_path, log=False) as second:
        assert Path(second.servos).exists()


def test_a_given_folder_stays_and_holds_what_a_session_needs(tmp_path: Path) -> None:
    """Catches files that go with the twin although a person asked to keep them, or a rig file that lies."""
    from rig.description import load_rig
    from simulator.twin import Twin

    with Twin(folder=tmp_path / "lab", log=False) as twin:
        rig = load_rig(twin.rig)
        assert (rig.ports.servos, rig.ports.lamp, str(rig.ports.frames)) == (
            twin.servos,
            twin.lamp,
            twin.frames,
        )
        assert [joint.id for joint in rig.joints] == twin.ids
        assert Path(twin.frames).stat().st_mode & 0o777 == 0o777
        assert Path(twin.servos).resolve().stat().st_mode & 0o666 == 0o666
    assert (tmp_path / "lab" / "rig.toml").exists()
    assert not (tmp_path / "lab" / "servos").exists()
    assert not (tmp_path / "lab" / "wire.log").exists()


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"rig": "/nonexistent/rig.toml"}, "rig.toml"),
        ({"materials": {"sample1": "lamberd:kd=0.5"}}, "lamberd"),
        ({"speed": 0.0}, "speed"),
        ({"folder": "/proc/nowhere"}, "/proc/nowhere"),
    ],
)
def test_what_it_cannot_be_is_said_in_one_line(options: dict[str, Any], what: str) -> None:
    """Catches a twin that dies with a traceback, or hangs, when it is asked for the impossible."""
    from simulator.twin import Twin

    with pytest.raises(BadInput) as refusal, Twin(**options):
        pass
    assert what in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_sigterm_ends_it_and_cleans_up() -> None:
    """Catches a temporary folder, or a light process, that stays behind."""
    command = [sys.executable, "-m", "simulator", "--no-log"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert list(ready) == ["servos", "baud", "ids", "lamp", "frames", "rig"]
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0
    assert not Path(ready["rig"]).parent.exists()


def test_the_wires_start_without_the_heavy_libraries() -> None:
    """Catches numpy, pydantic or Mitsuba in the process whose replies must not be late."""
    script = (
        "import sys, simulator.__main__\n"
        "print([name for name in ('numpy', 'pydantic', 'mitsuba') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_the_residual_is_uniform_and_repeats() -> None:
    """Catches a sub-tick offset that is zero, biased, or drawn anew: quantisation must be real."""
    drawn = [residual_ticks(1, servo_id, tick) for servo_id in range(1, 6) for tick in range(4096)]
    assert drawn[:10] == [residual_ticks(1, 1, tick) for tick in range(10)]
    assert min(drawn) >= -0.5
    assert max(drawn) < 0.5
    mean = sum(drawn) / len(drawn)
    assert abs(mean) < 4 * (1 / 12 / len(drawn)) ** 0.5
    assert sum(x * x for x in drawn) / len(drawn) == pytest.approx(1 / 12, rel=0.02)
    assert residual_ticks(2, 1, 0) != residual_ticks(1, 1, 0)


def test_truth_is_within_half_a_tick_of_what_the_servos_hold() -> None:
    """Catches true angles of the wrong joint or scale, and a station seen through the gap of the wheel."""
    import math

    from rig.description import default_rig

    rig: Rig = default_rig()
    ticks = {"light_elevation": 1024, "camera_azimuth": 2048, "camera_elevation": 3072, "turntable": 0}
    angles = true_angles_rad(rig, 3, ticks | {"station_wheel": 2048})
    nominal = [-math.pi / 2, 0.0, math.pi / 2, -math.pi]
    tick = 2 * math.pi / 4096
    assert all(0 < abs(a - n) <= tick / 2 for a, n in zip(angles, nominal, strict=True))
    stations = {"white": 2048, "trap": 2867, "sample1": 3686, "sample2": 410, "sample3": 1229}
    for name, wheel in stations.items():
        assert station_at(rig, ticks | {"station_wheel": wheel}) == name
        assert station_at(rig, ticks | {"station_wheel": wheel + 4096}) == name
        assert station_at(rig, ticks | {"station_wheel": wheel + 100}) is None


def test_backlash_is_in_the_picture_and_not_on_the_wire(twin: Callable[..., Twin]) -> None:
    """Catches play that a client could read off, or that leaves the picture as it was."""
    loose = twin(speed=100.0, backlash_deg=0.25)
    servos, lamp = Servos(loose), LampLine(loose)
    for goal in (2200, 2100):
        servos.move({4: goal})
        lamp.say("SHUT:EXP 0.01")
        while lamp.ask("SHUT?").startswith("BUSY"):
            time.sleep(0.01)
        assert servos.positions([4]) == [goal]
    hung = [event["behind"]["turntable"] for event in loose.wire_log() if event.get("event") == "exposed"]
    assert hung == pytest.approx([-0.125 / 360 * 4096, 0.125 / 360 * 4096])


def test_an_arm_hangs_behind_its_encoder() -> None:
    """Catches a picture of where the encoder is, though the arm hangs elsewhere."""
    from rig.description import default_rig

    rig = default_rig()
    ticks = {joint.name: 2048 for joint in rig.joints}
    straight, hanging = (true_angles_rad(rig, 3, ticks, behind) for behind in (None, {"turntable": 2.0}))
    off = [b - a for a, b in zip(straight, hanging, strict=True)]
    assert off == pytest.approx([0.0, 0.0, 0.0, 2 * 2 * math.pi / 4096])
