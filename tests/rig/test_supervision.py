"""Levels and their bands, on servos behind a wire."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from rig.bus import ServoBus
from rig.description import Supervision, default_rig, dump_rig, load_rig
from rig.errors import BadInput
from rig.supervision import Band, ServoLevels, Supervisor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from typing import Any

    from rig.description import Rig


@pytest.fixture
def make(servo_bench: Callable[..., Any]) -> Iterator[Callable[..., tuple[Any, Supervisor]]]:
    """Return a maker of a bench with a supervisor."""
    buses: list[ServoBus] = []

    def made(model: str = "XH430-W350", **fields: Any) -> tuple[Any, Supervisor]:
        rig: Rig = default_rig(supervision=Supervision(**fields))
        joints = tuple(joint.model_copy(update={"model": model}) for joint in rig.joints)
        bench = servo_bench(count=5, models=dict.fromkeys(range(1, 6), model))
        buses.append(ServoBus(bench.port, 1_000_000))
        return bench, Supervisor(rig.model_copy(update={"joints": joints}), buses[-1])

    yield made
    for bus in buses:
        bus.close()


def level(temperature_deg_c: float = 40.0, voltage_v: float = 12.0, load: float = 0.1) -> ServoLevels:
    """Return levels of the turntable."""
    return ServoLevels("turntable", temperature_deg_c, voltage_v, 0.0, load)


@pytest.mark.parametrize("model", ["XH430-W350", "XL430-W250", "XM540-W270"])
def test_a_healthy_machine_is_inside_its_bands(make: Callable[..., Any], model: str) -> None:
    """Would catch units mixed up: tenths of a volt, counts of current, per mille of load."""
    _, supervisor = make(model)
    levels = supervisor.read()
    assert [servo.joint for servo in levels][-1] == "station_wheel"
    for servo in levels:
        assert 15.0 < servo.temperature_deg_c < 60.0
        assert 9.0 < servo.voltage_v < 15.0
        assert (servo.current_ma is None) == model.startswith("XL")
        assert 0.0 <= servo.load < 0.5
    assert supervisor.breaches(levels) == ()


@pytest.mark.parametrize(
    ("changed", "quantity", "limits"),
    [
        ({"temperature_deg_c": 71.0}, "temperature", (-math.inf, 70.0)),
        ({"voltage_v": 9.9}, "voltage", (10.0, 14.8)),
        ({"voltage_v": 14.9}, "voltage", (10.0, 14.8)),
        ({"load": 0.81}, "load", (-math.inf, 0.8)),
    ],
)
def test_a_level_outside_is_named(
    make: Callable[..., Any], changed: dict[str, float], quantity: str, limits: tuple[float, float]
) -> None:
    """Would catch a band that reaches to where the servo itself cuts its torque, or ends elsewhere."""
    _, supervisor = make()
    (breach,) = supervisor.breaches([level(**changed)])
    assert (breach.joint, breach.quantity, breach.low, breach.high) == ("turntable", quantity, *limits)
    assert f"turntable {quantity} {next(iter(changed.values())):g}" in breach.told()


def test_bands_follow_the_rig_file_and_the_servo(make: Callable[..., Any]) -> None:
    """Would catch a margin kept from a factory's limit where the servo was set to another."""
    bench, supervisor = make(temperature_margin_deg_c=20.0, voltage_min_v=11.5, voltage_max_v=30.0)
    bench.servos[4]._registers.set("temperature_limit", 60)
    assert supervisor.breaches([level(40.0)]) == ()
    assert [breach.high for breach in supervisor.breaches([level(41.0)])] == [40.0]
    assert [breach.low for breach in supervisor.breaches([level(voltage_v=11.4)])] == [11.5]
    assert [breach.high for breach in supervisor.breaches([level(voltage_v=16.1)])] == [16.0]


def test_a_pause_ends_well_inside_the_band(make: Callable[..., Any]) -> None:
    """Would catch a machine that pauses at every second pose because it went on at the very limit."""
    _, supervisor = make()
    hot = supervisor.breaches([level(71.0, 14.8)])
    assert supervisor.breaches([level(69.0, 14.8)]) == ()
    assert [breach.quantity for breach in supervisor.breaches([level(69.0, 14.8)], hot)] == ["temperature"]
    assert supervisor.breaches([level(68.0, 14.8)], hot) == ()
    narrow = Band("turntable", "voltage", "V", 12.0, 12.1, 0.1)
    assert any(narrow.holds(12.0 + 0.01 * step, calm=True) for step in range(11))


@pytest.mark.parametrize("fields", [{"voltage_min_v": 13.0, "voltage_max_v": 12.0}, {"voltage_max_v": 9.0}])
def test_a_band_that_no_supply_could_keep_is_refused(tmp_path: Path, fields: dict[str, float]) -> None:
    """Would catch a capture that pauses for ever over a slip in the rig file."""
    rig = default_rig().model_copy(update={"supervision": Supervision(**fields)})
    dump_rig(rig, tmp_path / "rig.toml")
    with pytest.raises(BadInput, match=r"supervision\.voltage_m.*light_elevation"):
        load_rig(tmp_path / "rig.toml")
