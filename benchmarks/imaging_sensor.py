"""A sensor from its own frames, against what the twin's sensor is: gain, noise, clip level, hot pixels.

Eight cameras, each with its own gain (twelve or fourteen bits), read noise, full well, inequality and hot
pixels, look at a shaded white disc. Rows hold the worst of the eight; time is CPU time.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rows import row
from capture.characterise import SensorCharacter, characterise
from capture.sensor_frames import raw_files, sort_frames
from simulator.dng import DngMeta, exact_seconds, write_dng
from simulator.sensor import NOMINAL_EXPOSURE_S, NOMINAL_FILL, RGGB, Sensor

WIDTH, HEIGHT = 640, 480
FULL_S = NOMINAL_EXPOSURE_S / NOMINAL_FILL
FILLS = (*np.linspace(0.05, 0.95, 19), 1.6, 4.0)
DARKS_S = (0.001, 2.5, 5.0, 10.0)
DARKS, PAIRS = 8, 1


@dataclass(frozen=True)
class Judged:
    """One camera: relative errors, and how far from the truth in stated uncertainties."""

    gain: float
    read_noise: float
    clip_dn: float
    precision: float
    recall: float
    prnu: float
    pulls: tuple[float, float]
    seconds: float


def cameras() -> list[Sensor]:
    """Draw the cameras."""
    rng = np.random.default_rng(20)
    return [
        Sensor(
            WIDTH,
            HEIGHT,
            f"CAM-{number}",
            seed=number,
            bits=14 if number % 4 else 12,
            full_well_e=float(rng.uniform(20_000.0, 45_000.0)),
            read_noise_e=float(rng.uniform(2.5, 6.0)),
            dark_current_e_per_s=float(rng.uniform(0.1, 2.0)),
            prnu=float(rng.uniform(0.003, 0.012)),
            hot_fraction=float(rng.uniform(0.0005, 0.003)),
        )
        for number in range(8)
    ]


def shoot(sensor: Sensor, folder: Path) -> None:
    """Write all frames of one camera."""
    rng = np.random.default_rng(sensor.seed)
    rows, cols = np.mgrid[-1.0 : 1.0 : HEIGHT * 1j, -1.0 : 1.0 : WIDTH * 1j]
    disc = (1.0 - 0.15 * rows**2 + 0.05 * cols) * (np.hypot(rows, cols) < 1.1)
    plate = 0.9 / np.pi * disc[..., np.newaxis] * np.array([0.9, 1.0, 0.7])

    def write(name: str, exposure_s: float, *, lit: bool) -> None:
        meta = DngMeta(exact_seconds(exposure_s), sensor.black_dn, int(sensor.clip_dn), serial=sensor.serial)
        write_dng(folder / f"{name}.dng", sensor.expose(plate if lit else None, exposure_s, rng), meta)

    for level, exposure_s in enumerate(DARKS_S):
        for number in range(DARKS):
            write(f"dark-{level}-{number}", exposure_s, lit=False)
    for level, fill in enumerate(FILLS):
        for number in range(2 * PAIRS):
            write(f"flat-{level:02}-{number}", float(f"{fill * FULL_S:.4g}"), lit=True)


def judge(sensor: Sensor, found: SensorCharacter, seconds: float) -> Judged:
    """Compare what was found with what is."""
    line = found.transfer
    gain, read_dn = sensor.gain_dn_per_e, sensor.gain_dn_per_e * sensor.read_noise_e
    hot = sensor.dark_rate_e_per_s > sensor.dark_current_e_per_s
    both = float(np.count_nonzero(hot & found.dark.hot))
    full = np.reshape(sensor.black_dn, (2, 2)) + gain * sensor.full_well_e - 6.0 * read_dn
    # Full well or converter, whichever comes first by more than the noise; no camera lies in between.
    limits = np.where(full + 9.0 * read_dn < sensor.largest_dn, full, sensor.largest_dn)
    truth = [float(limits[np.array(RGGB) == channel].min()) for channel in range(3)]
    return Judged(
        gain=abs(line.gain_dn_per_e / gain - 1.0),
        read_noise=abs(line.read_noise_dn / read_dn - 1.0),
        clip_dn=float(np.abs(np.array(found.clip_dn) - truth).max()),
        precision=both / np.count_nonzero(found.dark.hot),
        recall=both / np.count_nonzero(hot),
        prnu=abs(found.prnu / sensor.prnu - 1.0),
        pulls=(
            (line.gain_dn_per_e - gain) / line.u_gain_dn_per_e,
            (line.read_noise_dn - read_dn) / line.u_read_noise_dn,
        ),
        seconds=seconds,
    )


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - a part's interface; there is nothing to draw
    """Characterise all cameras; see the module."""
    judged = []
    for sensor in cameras():
        with tempfile.TemporaryDirectory() as place:
            shoot(sensor, Path(place))
            begin = time.process_time()
            found = characterise(sort_frames(raw_files(Path(place)), Path(place)))
            judged.append(judge(sensor, found, time.process_time() - begin))
    pulls = np.array([each.pulls for each in judged])
    return [
        row("gain, worst error", 100 * max(each.gain for each in judged), "%", 0.3),
        row("read noise, worst error", 100 * max(each.read_noise for each in judged), "%", 2.0),
        row("gain and read noise, RMS of error over stated u", float(np.sqrt(np.mean(pulls**2))), "", 1.5),
        row("clip level of a channel, worst error", max(each.clip_dn for each in judged), "DN", 1.0),
        row("hot pixels, least precision", min(e.precision for e in judged), "", 0.99, at_least=True),
        row("hot pixels, least recall", min(e.recall for e in judged), "", 0.99, at_least=True),
        row("PRNU, worst error", 100 * max(each.prnu for each in judged), "%", 5.0),
        row("CPU time of one camera, 74 frames of 0.3 MP", max(each.seconds for each in judged), "s"),
    ]
