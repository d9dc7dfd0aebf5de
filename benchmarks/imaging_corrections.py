"""What the corrections leave of a drifting lamp, stray light, a tilted flat field, a bent response.

A session through the twin: its lamp loses 6 % within it, 1 % of a perfect diffuser lies over every frame,
the light trap stands at every third pose, and references are shot as the drift asks for. A tilted flat field
and a bent response are put into frames of closed-form light. Errors are of the worst pose's mean over all
channels, less what the white's certificate errs by.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.budget import budget
from analysis.corrections import Correction, straightened, u_linearity_of
from analysis.measurement import Image, Mosaic, Options, PoseImages, reduce_pose
from analysis.reduce import ReducedPose, assemble, joint_resolution, reduce_session
from analysis.white import LambertianWhite
from benchmarks.rows import row
from capture.interruptions import REFERENCE
from capture.merge import merge
from capture.plan import plan_from
from capture.run import capture
from capture.session import Session
from rig.description import default_rig, dump_rig
from rig.kinematics import Kinematics
from rig.pixels import irradiance, pixel_geometry
from rig.surroundings import TwinLight
from simulator.sensor import RGGB, Sensor
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Iterator

    import xarray as xr
    from numpy.typing import NDArray

    from rig.description import Rig

ALBEDO, DRIFT, EXPOSURES, FLOOR, BEND = 0.5, 0.06, 24, 0.01, 0.02
CHANNELS = ("R", "G", "B")
TARGET = 1e-3
TIMES_S = (0.02, 0.12)
PLAN: dict[str, Any] = {
    "plan": {"name": "corrections", "sample": "sample1"},
    "darks": {"count": 3},
    "trap": {"every": 3},
    "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [-60, -45, 0, 15, 45, 60]}],
}


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Give the rows."""
    del plots
    yield from _of_twin(drift=0.0)
    yield from _of_twin(drift=DRIFT)
    yield from _of_frames("tilted flat field, by a third", Correction.FLAT_FIELD, "flat field", tilt=0.2)
    yield from _of_frames("response 2 % short", Correction.LINEARITY, "linearity of the sensor", bend=BEND)


def _of_twin(drift: float) -> Iterator[dict[str, Any]]:
    """Capture and reduce a session under stray light and, perhaps, a drifting lamp."""
    name = f"lamp that loses {drift:.0%}" if drift else "steady lamp"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        dump_rig(default_rig(twin=TwinLight(stray_light=FLOOR)), folder / "rig.toml")
        (folder / "faults.toml").write_text(
            "".join(
                f'[[fault]]\nkind = "lamp-drift"\nat_exposure = {n}\nfor_s = 0.02\n'
                f"factor = {1.0 - drift * n / EXPOSURES}\n"
                for n in range(1, EXPOSURES + 1)
            )
        )
        with Twin(
            {"sample1": f"lambert:kd={ALBEDO}"},
            seed=3,
            speed=300.0,
            rig=folder / "rig.toml",
            faults=folder / "faults.toml" if drift else None,
            log=False,
        ) as twin:
            capture(plan_from(PLAN, "bench"), twin.rig, folder / "s")
            truth = json.loads((twin.folder / "truth.json").read_text())["white"]["rho"]
        with Session.open(folder / "s") as session:
            references = sum(
                event.kind == REFERENCE and event.detail["role"] == "white" for event in session.events()
            )
            tables = {
                left: reduce_session(session, options=Options(without=left))
                for left in ((), (Correction.LAMP_DRIFT,), (Correction.STRAY_LIGHT,))
            }
            white = truth / session.rig.white.rho
    error = {left: _worst(samples, white) for left, samples in tables.items()}
    stated = {
        left: {line.name: line.of_sample for line in budget(samples)} for left, samples in tables.items()
    }
    yield row(f"{name}: white references shot again", references)
    yield row(f"{name}, 1 % stray light: error, all corrected", 100 * error[()], "%", 100 * TARGET)
    if drift:
        yield row(f"{name}: error, lamp drift left in", 100 * error[(Correction.LAMP_DRIFT,)], "%")
        yield row(
            f"{name}: stated of the lamp", 100 * stated[(Correction.LAMP_DRIFT,)]["drift of the lamp"], "%"
        )
        return
    yield row("1 % stray light: error, left in", 100 * error[(Correction.STRAY_LIGHT,)], "%")
    yield row("1 % stray light: stated of it", 100 * stated[(Correction.STRAY_LIGHT,)]["stray light"], "%")


def _of_frames(
    name: str, correction: Correction, line: str, *, tilt: float = 0.0, bend: float = 0.0
) -> Iterator[dict[str, Any]]:
    """Reduce a pose of closed-form light with and without a correction."""
    rig = default_rig()
    sensor = Sensor(rig.camera.width_px, rig.camera.height_px, serial="BENCH", seed=4, bend=bend)
    model = sensor.calibration()
    rng = np.random.default_rng(8)
    angles = Kinematics(rig).solve([0.5, 0.0, np.sqrt(0.75)], [-0.3, 0.0, np.sqrt(0.91)])
    cols = np.linspace(-1.0, 1.0, rig.camera.width_px)[np.newaxis, :, np.newaxis]
    flat = 1.0 - tilt - tilt * cols
    for without in ((), (correction,)):
        straight = correction is Correction.LINEARITY and not without
        paint, white = (
            _image(rig, sensor, angles, albedo * flat, rng, straight=straight)
            for albedo in (0.2, rig.white.rho)
        )
        options = Options(without=without)
        mosaic = Mosaic.repeat(np.array(RGGB), CHANNELS, paint.radiance.shape)
        reference, u_joint = LambertianWhite.of(rig), joint_resolution(rig)
        images = PoseImages(paint, white)
        reduced = reduce_pose(rig, images, mosaic, reference, u_joint_rad=u_joint, options=options)
        samples = assemble(
            rig,
            [ReducedPose(0, 0, (0,) * 4, reduced)],
            CHANNELS,
            options=options,
            u_linearity=u_linearity_of(model, corrected=straight) if bend else None,
        )
        relative = samples["f_r"].to_numpy() * np.pi / 0.2 - 1.0
        column = reduced.bin_index % (rig.camera.width_px // options.bin_px)
        thirds = np.array_split(np.unique(column), 3)
        worst = max(abs(float(np.nanmean(relative[np.isin(column, third)]))) for third in thirds)
        what = "left in" if without else "corrected"
        target = None if without else 100 * TARGET
        yield row(f"{name}: error of the worst third of the picture, {what}", 100 * worst, "%", target)
        stated = {each.name: each.of_sample for each in budget(samples)}
        if line in stated:
            yield row(f"{name}: stated of it, {what}", 100 * stated[line], "%")


def _image(
    rig: Rig,
    sensor: Sensor,
    angles: NDArray[np.float64],
    albedo: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    straight: bool,
) -> Image:
    """Expose and merge a Lambertian surface."""
    geometry = pixel_geometry(rig, angles)
    light = irradiance(rig, geometry)[..., np.newaxis] * geometry.on_sample[..., np.newaxis]
    frames = [sensor.expose(albedo / np.pi * light * np.ones(3), time, rng) for time in TIMES_S]
    model = sensor.calibration()
    merged = merge(frames, TIMES_S, sensor=model)
    radiance = np.asarray(merged.radiance, dtype=np.float64)
    if straight and model.response is not None:
        radiance = radiance * straightened(radiance, TIMES_S, model.response)
    return Image(radiance, np.asarray(merged.variance, dtype=np.float64), merged.flags, angles)


def _worst(samples: xr.Dataset, white: float) -> float:
    """Largest relative error of a pose's mean."""
    relative = samples["f_r"] * white * np.pi / ALBEDO - 1.0
    return float(np.abs(relative.groupby(samples["pose"]).mean("sample").mean("channel")).max())
