"""The sensor's calibration file: round trip, electrons and DN, and every wrong value named."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture.sensor import SensorModel, load_sensor, save_sensor
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

positive = st.floats(1e-6, 1e6)


@given(
    gain=positive,
    noise=st.floats(0, 1e4),
    clip=st.one_of(st.floats(200, 1e6), st.tuples(*[st.floats(200, 1e6)] * 3)),
    black=st.one_of(st.none(), st.tuples(*[st.floats(0, 100)] * 4)),
    serial=st.one_of(
        st.none(), st.text(st.characters(codec="utf-8", exclude_categories=("Cc",)), max_size=8)
    ),
)
def test_file_round_trip(
    tmp_path_factory: pytest.TempPathFactory,
    *,
    gain: float,
    noise: float,
    clip: float | tuple[float, ...],
    black: tuple[float, ...] | None,
    serial: str | None,
) -> None:
    """Would catch a value lost, rounded or put under another key."""
    sensor = SensorModel(gain, noise, clip, black_dn=black, camera_serial=serial)
    path = tmp_path_factory.mktemp("s") / "sensor.toml"
    save_sensor(sensor, path)
    assert load_sensor(path) == sensor


def test_electrons_become_dn(tmp_path: Path) -> None:
    """Would catch the read noise in electrons taken for DN."""
    path = tmp_path / "sensor.toml"
    path.write_text(
        "gain_dn_per_e = 0.5\nread_noise_e = 3\ndark_current_e_per_s = 2\nclip_dn = [9, 8, 7]\nblack_dn = 1\n"
    )
    sensor = load_sensor(path)
    assert sensor.read_noise_dn == 1.5
    assert sensor.dark_current_dn_per_s == 1.0
    assert sensor.black_dn == (1, 1, 1, 1)
    assert [sensor.clip_of_channel(channel) for channel in (0, 1, 2)] == [9, 8, 7]
    assert sensor.floor_variance_dn2 == pytest.approx(1.5**2 + 1 / 12)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("gain_dn_per_e = 0\nread_noise_dn = 1\nclip_dn = 9", "gain_dn_per_e"),
        ("gain_dn_per_e = 1\nread_noise_dn = -1\nclip_dn = 9", "read_noise_dn"),
        ("gain_dn_per_e = 1\nread_noise_dn = nan\nclip_dn = 9", "read_noise_dn"),
        ("gain_dn_per_e = 1\nread_noise_dn = 1\nclip_dn = []", "clip_dn"),
        ("gain_dn_per_e = 1\nread_noise_dn = 1\nclip_dn = 9\nblack_dn = [1, 2]", "black_dn"),
        ("gain_dn_per_e = 1\nread_noise_dn = 1\nclip_dn = 9\nblack_dn = 10", "clip_dn"),
        ("gain_dn_per_e = 1\nread_noise_dn = 1\nread_noise_e = 1\nclip_dn = 9", "read_noise_e"),
        ("gain_dn_per_e = 1\nread_niose_e = 1\nclip_dn = 9", "did you mean read_noise_e"),
        ("gain_dn_per_e = '1'\nread_noise_dn = 1\nclip_dn = 9", "gain_dn_per_e"),
        ("read_noise_e = 1\nclip_dn = 9", "gain_dn_per_e"),
        ("version = 2\ngain_dn_per_e = 1\nread_noise_dn = 1\nclip_dn = 9", "version"),
        ("gain_dn_per_e = 1\nread_noise_dn = 1\nclip_dn = 9\ntruncated = 1", "truncated"),
        ("gain_dn_per_e = ", "TOML"),
    ],
)
def test_wrong_value_is_named(tmp_path: Path, text: str, named: str) -> None:
    """Would catch a typo or an impossible value accepted in silence."""
    path = tmp_path / "sensor.toml"
    path.write_text(text)
    with pytest.raises(BadInput, match=r"sensor\.toml") as error:
        load_sensor(path)
    assert named in str(error.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    """Would catch a traceback for the commonest mistake."""
    with pytest.raises(BadInput, match=r"absent\.toml"):
        load_sensor(tmp_path / "absent.toml")


def test_clip_of_a_channel_that_is_not_there() -> None:
    """Would catch a clip level of another channel used for a mono or a four-channel camera."""
    with pytest.raises(BadInput, match="channel 2"):
        SensorModel(1.0, 1.0, (9.0, 8.0)).clip_of_channel(2)
