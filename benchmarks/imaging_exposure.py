"""Exposure planning against fixed ladders: frames and time for a range of radiance and an SNR.

The sensor of the target: fourteen bits, 0.4 DN per electron, 3 DN of read noise; shutter in thirds of a
stop from 0.1 ms to 60 s; 0.3 s overhead a frame; five decades from 30 DN/s. Further scenes are drawn, and
everything that is planned is simulated, merged and judged by its scatter.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.rows import row
from capture.bracketing import BracketPlan, Camera, Objective, Scene, plan_bracket
from capture.exposure import Noise, Shutter
from capture.merge import merge
from capture.sensor import SensorModel

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SENSOR = SensorModel(0.4, 3.0, 16383.0)
BLACK = 512.0
CAMERA = Camera(Shutter(1e-4, 60.0, 3), Noise.of(SENSOR), 16383.0 - BLACK, overhead_s=0.3)
LOW, SNR = 30.0, 30.0
SCENE = Scene(LOW, LOW * 1e5, SNR)
DRAWN = 40
LEVELS, PIXELS = 200, 4000


def ladder(scene: Scene, factor: float) -> list[float]:
    """Take fixed steps from the longest exposure that clips nothing, until all is seen well."""
    exposures: list[float] = []
    exposure_s = CAMERA.limit_dn / scene.high_dn_per_s
    while CAMERA.brightest_gap(scene, exposures) is not None:
        exposures.append(exposure_s)
        exposure_s *= factor
    return exposures


def simulated_snr(scene: Scene, exposures_s: Sequence[float], seed: int) -> float:
    """Worst signal-to-noise ratio of the merge over the range, smoothed over neighbours against chance."""
    rng = np.random.default_rng(seed)
    radiance = np.geomspace(scene.low_dn_per_s, scene.high_dn_per_s, LEVELS)[:, np.newaxis]
    radiance = np.repeat(radiance, PIXELS, axis=1)
    frames = []
    for exposure_s in exposures_s:
        electrons = rng.poisson(np.minimum(radiance * exposure_s, 1e5) / 0.4)
        counts = electrons * 0.4 + 3.0 * rng.standard_normal(radiance.shape) + BLACK
        frames.append(np.clip(np.rint(counts), 0, 16383).astype(np.uint16))
    merged = merge(frames, list(exposures_s), dark=BLACK, sensor=SENSOR).radiance.astype(np.float64)
    return float((merged.mean(axis=1) / merged.std(axis=1)).min())


def drawn_scenes() -> list[Scene]:
    """Draw scenes of one to five decades, with SNR from 10 to 100."""
    rng = np.random.default_rng(3)
    return [
        Scene(low, low * 10.0 ** float(rng.uniform(1.0, 5.0)), 10.0 ** float(rng.uniform(1.0, 2.0)))
        for low in 10.0 ** rng.uniform(1.5, 3.0, DRAWN)
    ]


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Plan, count and simulate; see the module."""
    plans: dict[Objective, BracketPlan] = {}
    seconds = {}
    for objective in Objective:
        begin = time.process_time()
        plans[objective] = plan_bracket(SCENE, CAMERA, objective)
        seconds[objective] = time.process_time() - begin
    fewest, quickest = plans[Objective.FRAMES], plans[Objective.TIME]
    steps = {factor: ladder(SCENE, factor) for factor in (2.0, 4.0, 8.0)}
    rows = [
        row("5 decades, SNR 30: frames, fewest", len(fewest.exposures_s), "", 5),
        row("5 decades, SNR 30: time of the fewest", fewest.seconds, "s"),
        row("5 decades, SNR 30: frames, quickest", len(quickest.exposures_s)),
        row("5 decades, SNR 30: time of the quickest", quickest.seconds, "s", fewest.seconds),
        *(
            row(f"5 decades, SNR 30: frames, fixed {factor:g}x", len(exposures))
            for factor, exposures in steps.items()
        ),
        *(
            row(f"5 decades, SNR 30: time, fixed {factor:g}x", CAMERA.seconds(exposures), "s")
            for factor, exposures in steps.items()
        ),
        *(
            row(f"5 decades: worst simulated SNR, {name}", value, "", 0.97 * SNR, at_least=True)
            for name, value in (
                ("fewest", simulated_snr(SCENE, fewest.exposures_s, 1)),
                ("quickest", simulated_snr(SCENE, quickest.exposures_s, 2)),
            )
        ),
        row("CPU time of a plan, fewest", 1e3 * seconds[Objective.FRAMES], "ms", 50.0),
        row("CPU time of a plan, quickest", 1e3 * seconds[Objective.TIME], "ms", 2000.0),
        *_drawn(),
    ]
    if plots is not None:
        _plot(plots / "imaging_exposure.png", {"fewest frames": fewest.exposures_s, "fixed 4x": steps[4.0]})
    return rows


def _drawn() -> list[dict[str, Any]]:
    """Rows over drawn scenes: what is saved, and whether promises hold."""
    frames, times, kept = [], [], []
    for number, scene in enumerate(drawn_scenes()):
        fewest, quickest = (plan_bracket(scene, CAMERA, objective) for objective in Objective)
        steps = ladder(scene, 4.0)
        if not fewest.complete or len(steps) > 60:
            continue
        frames.append(len(fewest.exposures_s) / len(steps))
        times.append(quickest.seconds / CAMERA.seconds(steps))
        if number % 4 == 0:
            kept.append(simulated_snr(scene, fewest.exposures_s, number) / scene.snr)
    return [
        row(
            f"{len(frames)} drawn scenes: frames over those of a 4x ladder, mean",
            float(np.mean(frames)),
            "x",
            1.0,
        ),
        row(
            f"{len(frames)} drawn scenes: time over that of a 4x ladder, mean",
            float(np.mean(times)),
            "x",
            1.0,
        ),
        row("drawn scenes: worst simulated over promised SNR", min(kept), "", 0.95, at_least=True),
    ]


def _plot(path: Path, brackets: dict[str, Sequence[float]]) -> None:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 10}):
        figure = Figure(figsize=(6.5, 4), layout="constrained")
        axes = figure.add_subplot()
        radiance = np.geomspace(SCENE.low_dn_per_s, SCENE.high_dn_per_s, 2000)
        for name, exposures in brackets.items():
            snr = [CAMERA.snr(float(x), exposures) for x in radiance]
            label = f"{name}: {len(exposures)} frames, {CAMERA.seconds(exposures):.1f} s"
            axes.loglog(radiance, snr, label=label)
        axes.axhline(SNR, color="black", linewidth=0.8)
        axes.set_xlabel("radiance / DN/s")
        axes.set_ylabel("signal-to-noise ratio of the merge")
        axes.grid(visible=True, which="both", alpha=0.3)
        axes.legend()
        figure.savefig(path, dpi=120)
