"""Whether 95 % intervals hold the truth over sessions whose frames are rendered.

Light of the twin's own renderer, frames of its sensor with darks, merged and reduced by the program. Each
session has a material, three poses, and hidden errors of its own, drawn from what the budget states: the
joints' true angles within a step, the white's albedo, its evenness from place to place, the lamp's output and
the photodiode's error. Wires, files and journal are left out: no number depends on them. The truth is the
material's closed form at the stated directions.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.budget import components, u_of_samples
from analysis.measurement import Image, Mosaic, Options, PoseImages, reduce_pose
from analysis.reduce import ReducedPose, assemble, joint_resolution
from analysis.white import LambertianWhite
from benchmarks.coverage_study import BRACKET, BRIGHTEST, CAMERA_STEP, CHANNELS, Bench
from benchmarks.imaging_coverage import K95, drawn_goal, drawn_material, machine
from benchmarks.rows import row
from capture.merge import merge
from rig.ticks import ticks_to_rad
from simulator.sensor import RGGB
from simulator.truth import residual_ticks

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]

SESSIONS, POSES = 400, 3
OUTPUT_SPREAD = 0.02
"""How far the lamp's light is from picture to picture; the photodiode follows it."""
LOW, HIGH = 90.0, 99.0


def line_of(material: Model) -> str:
    """Write a material as the twin takes it."""
    values = {p.name: np.atleast_1d(getattr(material, p.name)) for p in material.PARAMETERS}
    listed = (f"{name}={'/'.join(f'{x:.17g}' for x in value)}" for name, value in values.items())
    return f"{material.NAME}:{','.join(listed)}"


class Session:
    """One session: a machine with hidden errors.

    Parameters
    ----------
    seed : int
        Decides all of them, the material, the poses and the noise.
    """

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng((20261123, seed))
        self.material = drawn_material(self.rng)
        self.bench = Bench(machine(), seed, {"sample1": line_of(self.material)})
        rig = self.bench.rig
        shape = (rig.camera.height_px, rig.camera.width_px)
        self.mosaic = Mosaic.repeat(np.array(RGGB), CHANNELS, shape)
        self.options = Options()
        bin_px = self.options.bin_px
        places = self.rng.standard_normal((math.ceil(shape[0] / bin_px), math.ceil(shape[1] / bin_px)))
        uneven = np.kron(places, np.ones((bin_px, bin_px)))[: shape[0], : shape[1]]
        self.flat = 1.0 + rig.white.u_uniformity * uneven[..., np.newaxis]

    def reduced(self) -> xr.Dataset:
        """Expose, merge and reduce all poses."""
        rig, poses = self.bench.rig, []
        for number in range(POSES):
            ticks, stated = drawn_goal(rig, self.rng)
            true = tuple(
                ticks_to_rad(joint, tick + residual_ticks(self.bench.seed, joint.id, tick))
                for joint, tick in zip(rig.arm_joints, ticks, strict=True)
            )
            images = PoseImages(self.image("sample1", true, stated), self.image("white", true, stated))
            reduced = reduce_pose(
                rig,
                images,
                self.mosaic,
                LambertianWhite.of(rig),
                u_joint_rad=joint_resolution(rig),
                options=self.options,
            )
            poses.append(ReducedPose(number, number, ticks, reduced))
        return assemble(rig, poses, CHANNELS, options=self.options)

    def image(self, station: str, true_rad: tuple[float, ...], stated_rad: Array) -> Image:
        """Render, expose and merge one picture, under a lamp that is not quite steady."""
        bench = self.bench
        output = 1.0 + OUTPUT_SPREAD * self.rng.standard_normal()
        radiance = output * bench.renderer.radiance(station, true_rad)
        if station == "white":
            radiance = radiance * self.flat
        sensor = bench.sensor
        brightest = float(radiance.max()) * sensor.electrons_per_radiance_s / sensor.full_well_e
        short = CAMERA_STEP ** math.floor(math.log(BRIGHTEST / brightest, CAMERA_STEP))
        times = [short, short * BRACKET]
        frames = [sensor.expose(radiance, time, bench.rng) for time in times]
        merged = merge(frames, times, dark=bench.dark(times), sensor=bench.model)
        reading = output * (1.0 + bench.rig.lamp.u_monitor * self.rng.standard_normal())
        radiance, variance = merged.radiance.astype(np.float64), merged.variance.astype(np.float64)
        return Image(radiance, variance, merged.flags, stated_rad, lamp_output=reading)


def held(seed: int) -> float:
    """Share of a session's intervals that hold the truth."""
    session = Session(seed)
    samples = session.reduced()
    f_r = samples["f_r"].to_numpy()
    truth = session.material.evaluate(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    u, used = u_of_samples(components(samples, session.material)), np.isfinite(f_r)
    error = np.abs(f_r - np.broadcast_to(truth, f_r.shape))
    return float(np.mean(error[used] <= K95 * u[used]))


def study(sessions: int) -> tuple[float, float]:
    """Coverage in percent over sessions, and its standard error."""
    found = np.array([held(seed) for seed in range(sessions)])
    return 100.0 * float(found.mean()), 100.0 * float(found.std(ddof=1)) / math.sqrt(sessions)


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - a part's interface; there is nothing to draw
    """Render all sessions; see the module."""
    coverage, error = study(SESSIONS)
    name = f"coverage of 95 % intervals over {SESSIONS} sessions with rendered frames"
    return [
        row(name, coverage, "%", LOW, at_least=True),
        row(f"{name}, not more than", coverage, "%", HIGH),
        row(f"{name}: standard error", error, "%"),
    ]
