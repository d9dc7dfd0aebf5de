"""Do stated uncertainties hold? Many seeds of the demonstration, without wires.

    python -m benchmarks.coverage_study --seeds 20

Light, sensor, merge, reduction and fit are those of the demonstration; ports, files and journal, which no
number depends on, are left out. Prints, per parameter, bias, scatter over the seeds, mean stated u, and how
many pulls lie beyond 3.
"""

from __future__ import annotations

import argparse
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.fit import fit
from analysis.measurement import Image, Mosaic, Options, PoseImages, reduce_pose
from analysis.reduce import ReducedPose, assemble, joint_resolution
from analysis.table import parameter_rows
from analysis.white import LambertianWhite
from capture.dark import DarkModel
from capture.merge import merge
from gonio.demo_samples import SAMPLES, DemoSample, Pose
from rig.description import default_rig
from rig.kinematics import Kinematics
from rig.ticks import rad_to_ticks, ticks_to_rad
from simulator.frames import true_white_rho
from simulator.light.renderer import Renderer
from simulator.sensor import RGGB, Sensor, derived_seed
from simulator.truth import residual_ticks

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from numpy.typing import NDArray

    from analysis.table import Row
    from rig.description import Rig

CHANNELS = ("R", "G", "B")
CAMERA_STEP = 2 ** (1 / 3)
DARKS_PER_EXPOSURE = 8
BRIGHTEST = 0.7
BRACKET = 8.0
SEEDS = 20


class Bench:
    """One seed's machine: what its camera sees at any pose, noise and hidden errors included.

    Parameters
    ----------
    rig : Rig
        The machine.
    seed : int
        Decides noise, the joints' true angles, the white's true albedo.
    materials : mapping of str to str
        By station.
    """

    def __init__(self, rig: Rig, seed: int, materials: dict[str, str]) -> None:
        self.rig, self.seed = rig, seed
        self.renderer = Renderer(rig, materials, white_rho=true_white_rho(rig, seed))
        self.sensor = Sensor(rig.camera.width_px, rig.camera.height_px, serial=rig.camera.serial, seed=seed)
        self.model = self.sensor.calibration()
        self.rng = np.random.default_rng(derived_seed("coverage", seed))
        self.darks: dict[float, DarkModel] = {}

    def held(self, pose: Pose) -> tuple[tuple[int, ...], NDArray[np.float64], tuple[float, ...]]:
        """Ticks, measured angles and true angles of the arms at a pose."""
        theta_i, phi_i, theta_o, phi_o = np.deg2rad(pose)
        wi, wo = (
            np.array([math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)])
            for t, p in ((theta_i, phi_i), (theta_o, phi_o))
        )
        goal = Kinematics(self.rig).solve(wi, wo)
        joints = self.rig.arm_joints
        ticks = tuple(int(rad_to_ticks(j, float(a))) for j, a in zip(joints, goal, strict=True))
        measured = np.array([ticks_to_rad(j, t) for j, t in zip(joints, ticks, strict=True)])
        true = tuple(
            ticks_to_rad(j, t + residual_ticks(self.seed, j.id, t))
            for j, t in zip(joints, ticks, strict=True)
        )
        return ticks, measured, true

    def image(self, station: str, true_rad: tuple[float, ...], measured_rad: NDArray[np.float64]) -> Image:
        """Expose and merge one pose: the longest time that clips nothing, and one `BRACKET` times longer."""
        radiance = self.renderer.radiance(station, true_rad)
        brightest = float(radiance.max()) * self.sensor.electrons_per_radiance_s / self.sensor.full_well_e
        short = CAMERA_STEP ** math.floor(math.log(BRIGHTEST / brightest, CAMERA_STEP))
        times = [time for time in (short, short * BRACKET) if time <= self.rig.camera.longest_exposure_s]
        frames = [self.sensor.expose(radiance, time, self.rng) for time in times]
        merged = merge(frames, times, dark=self.dark(times), sensor=self.model)
        return Image(merged.radiance, merged.variance, merged.flags, measured_rad)

    def dark(self, times: list[float]) -> DarkModel:
        """Return what is dark at these exposures, of frames shot once for each."""
        key = times[0]
        if key not in self.darks:
            exposures = [time for time in times for _ in range(DARKS_PER_EXPOSURE)]
            frames = [self.sensor.expose(None, time, self.rng) for time in exposures]
            self.darks[key] = DarkModel.from_frames(frames, exposures)
        return self.darks[key]


def measure(bench: Bench, sample: DemoSample) -> xr.Dataset:
    """Measure one sample at its poses and reduce it."""
    rig = bench.rig
    shape = (rig.camera.height_px, rig.camera.width_px)
    mosaic = Mosaic.repeat(np.array(RGGB), CHANNELS, shape)
    options, reference, u_joint = Options(), LambertianWhite.of(rig), joint_resolution(rig)
    poses = []
    for number, pose in enumerate(sample.poses):
        ticks, measured, true = bench.held(pose)
        images = PoseImages(*(bench.image(name, true, measured) for name in (sample.station, "white")))
        reduced = reduce_pose(rig, images, mosaic, reference, u_joint_rad=u_joint, options=options)
        poses.append(ReducedPose(number, number, ticks, reduced))
    return assemble(rig, poses, CHANNELS, options=options, source=sample.name)


def recovered(seed: int) -> list[tuple[str, Row]]:
    """Measure and fit every sample of the demonstration with one seed; rows by sample's name."""
    rig = default_rig()
    bench = Bench(rig, seed, {sample.station: sample.material for sample in SAMPLES})
    rows = []
    for sample in SAMPLES:
        result = fit(measure(bench, sample), sample.model)
        truth = dict(bench.renderer.materials[sample.station].truth)
        if "ior" in truth:
            f0 = ((np.array(truth["ior"]) - 1) / (np.array(truth["ior"]) + 1)) ** 2
            truth["ks_F0"] = (np.array(truth["ks"]) * f0).tolist()
        rows += [(sample.name, row) for row in parameter_rows(result, CHANNELS, truth)]
    return rows


def summarise(runs: list[list[tuple[str, Row]]]) -> list[dict[str, float | str]]:
    """Compare stated uncertainty with scatter, one entry per parameter."""
    summary: list[dict[str, float | str]] = []
    for rows in zip(*runs, strict=True):
        name, first = rows[0]
        values = np.array([row.value for _, row in rows])
        stated = np.array([row.u for _, row in rows])
        assert first.true is not None
        pulls = (values - first.true) / stated
        summary.append(
            {
                "name": f"{name}: {first.name} {first.channel}".strip(),
                "worst_percent": float(100 * np.abs(values / first.true - 1).max()),
                "bias_percent": float(100 * (values.mean() / first.true - 1)),
                "scatter_percent": float(100 * values.std(ddof=1) / first.true),
                "u_percent": float(100 * stated.mean() / first.true),
                "pull_rms": float(np.sqrt(np.mean(pulls**2))),
                "beyond_3": int(np.count_nonzero(np.abs(pulls) > 3)),
            }
        )
    return summary


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - a part's interface; there is nothing to draw
    """Study 20 seeds: rows of name, value, unit, target and ok, as `gonio bench` takes them."""
    summary = summarise([recovered(seed) for seed in range(SEEDS)])
    beyond = sum(int(entry["beyond_3"]) for entry in summary) / (SEEDS * len(summary))
    ratio = max(float(entry["u_percent"]) / float(entry["scatter_percent"]) for entry in summary)
    rows = [
        _row("parameters beyond 3 stated u", 100 * beyond, "%", 5.0),
        _row("largest stated u over scatter", ratio, "x", 3.0),
        _row("largest RMS of pulls", max(float(entry["pull_rms"]) for entry in summary), "", 1.5),
    ]
    bounds = {"Matte paint: kd": 0.3, "exponent": 2.0, "dielectric: m": 1.0, "ks_F0": 2.0}
    for part, bound in bounds.items():
        worst = max(float(entry["worst_percent"]) for entry in summary if part in str(entry["name"]))
        rows.append(_row(f"worst error of {part}", worst, "%", bound))
    return rows


def _row(name: str, value: float, unit: str, target: float) -> dict[str, Any]:
    return {"name": name, "value": value, "unit": unit, "target": target, "ok": value <= target}


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.processes) as pool:
        runs = list(pool.map(recovered, range(options.seeds)))
    for entry in summarise(runs):
        print(
            f"{entry['name']:30} worst {entry['worst_percent']:7.3f} %  "
            f"bias {entry['bias_percent']:+8.4f} %  "
            f"scatter {entry['scatter_percent']:7.4f} %  u {entry['u_percent']:7.4f} %  "
            f"pull rms {entry['pull_rms']:5.2f}  |pull| > 3: {entry['beyond_3']}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
