"""Do 95 % intervals hold the truth? Thousands of sessions drawn at the reduction level.

Each session has a material, a pose, a certificate and a plate of its own. Everything systematic is drawn
anew from the distributions that the budget states: the true angles within the encoders' steps, the
certificate's error, the plate's shape and what no term of it follows; then the merged images of sample and
white get the noise of their counts, and are reduced as measured ones are. The interval of a sample is
f_r +- 1.96 u with all components of `analysis.budget`; the truth is the material's f_r at the sample's
nominal directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.budget import components, u_of_combination, u_of_samples
from analysis.measurement import Image, Mosaic, Options, PoseImages, reduce_pose
from analysis.models import MODELS
from analysis.reduce import ReducedPose, assemble, joint_resolution
from analysis.white import PlateWhite
from analysis.white_shape import PRIOR, PtfeShape
from benchmarks.rows import row
from rig.description import Camera, default_rig
from rig.kinematics import Kinematics
from rig.pixels import irradiance, pixel_geometry
from rig.ticks import rad_to_ticks, tick_rad, ticks_to_rad

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model
    from rig.description import Rig

    Array = NDArray[np.float64]

SESSIONS = 4200
SIDE_PX = 32
U_CERTIFICATE = 0.004
GAIN_DN_PER_E, FLOOR_DN2 = 0.5, 2.4
FULL_DN = 9000.0
K95 = 1.959964
CHANNELS = ("R", "G", "B")
MEASURED_POINTS = 24


@dataclass(frozen=True)
class Truth:
    """What one session hides.

    Attributes
    ----------
    angles_rad : ndarray, shape (J,)
        True angles of the joints.
    rho : float
        True certificate value.
    shape : PtfeShape
        True coefficients.
    rest : float
        Relative departure of the plate that no term follows.
    """

    angles_rad: Array
    rho: float
    shape: PtfeShape
    rest: float


def machine() -> Rig:
    """Describe a machine with few pixels."""
    middle = (SIDE_PX - 1) / 2.0
    camera = Camera(
        serial="COVERAGE",
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        focal_length_px=600.0,
        principal_point_px=(middle, middle),
    )
    return default_rig(camera=camera)


def drawn_material(rng: np.random.Generator) -> Model:
    """Draw a matt or a glossy material."""
    kd = rng.uniform(0.05, 0.8, 3)
    if rng.random() < 0.5:
        return MODELS["lambert"](kd=kd)
    return MODELS["cook-torrance"](
        kd=0.5 * kd, ks=rng.uniform(0.1, 0.8), m=rng.uniform(0.25, 0.5), ior=rng.uniform(1.3, 1.8)
    )


def drawn_goal(rig: Rig, rng: np.random.Generator) -> tuple[tuple[int, ...], Array]:
    """Draw a pose; give the encoders' ticks and the angles that they state."""
    while True:
        theta, phi = rng.uniform(0.0, np.deg2rad(55.0), 2), rng.uniform(0.0, 2.0 * np.pi)
        wi = np.array([np.sin(theta[0]), 0.0, np.cos(theta[0])])
        wo = np.array([np.sin(theta[1]) * np.cos(phi), np.sin(theta[1]) * np.sin(phi), np.cos(theta[1])])
        if np.arccos(np.clip(wi @ wo, -1.0, 1.0)) > np.deg2rad(rig.clearance.min_separation_deg):
            break
    goal = Kinematics(rig).solve(wi, wo)
    ticks = tuple(int(rad_to_ticks(j, float(a))) for j, a in zip(rig.arm_joints, goal, strict=True))
    stated = np.array([ticks_to_rad(j, t) for j, t in zip(rig.arm_joints, ticks, strict=True)])
    return ticks, stated


def image(radiance: Array, scale: float, rng: np.random.Generator, angles_rad: Array) -> Image:
    """Give counts per second their noise; the stated variance is that of what was counted."""
    signal = radiance * scale
    counted = signal + rng.standard_normal(signal.shape) * np.sqrt(GAIN_DN_PER_E * signal + FLOOR_DN2)
    variance = GAIN_DN_PER_E * np.maximum(counted, 0.0) + FLOOR_DN2
    flags = np.zeros(signal.shape, dtype=np.uint8)
    return Image(counted / scale, variance / scale**2, flags, angles_rad)


class Study:
    """Draws sessions on one machine, with one way of knowing the white.

    Parameters
    ----------
    measured : bool
        Whether the plate's shape was narrowed by measured points, or is the generic one.
    """

    def __init__(self, *, measured: bool) -> None:
        self.measured = measured
        self.rig = machine()
        self.channel = Mosaic.repeat(np.array(((0, 1), (1, 2))), CHANNELS, (SIDE_PX, SIDE_PX))

    def white(self, rng: np.random.Generator) -> tuple[PlateWhite, Truth, tuple[int, ...], Array]:
        """Draw what is hidden, and what is known of the white."""
        ticks, stated = drawn_goal(self.rig, rng)
        steps = np.array([tick_rad(joint) for joint in self.rig.arm_joints])
        count = len(PtfeShape.generic().coefficients)
        rho = 0.98 + U_CERTIFICATE * rng.standard_normal()
        plate = PtfeShape(PRIOR * rng.standard_normal(count), np.zeros((count, count)), 0.0)
        known = self._points(plate, rng) if self.measured else PtfeShape.generic()
        truth = Truth(
            angles_rad=stated + steps * rng.uniform(-0.5, 0.5, len(steps)),
            rho=rho,
            shape=plate,
            rest=known.u_rest * rng.standard_normal(),
        )
        certificate = (np.array([0.98]), np.array([U_CERTIFICATE]))
        return PlateWhite(*certificate, known, "drawn"), truth, ticks, stated

    @staticmethod
    def _points(plate: PtfeShape, rng: np.random.Generator) -> PtfeShape:
        """Measure points of the plate, each to half a percent, on a scale of their own."""
        cosine, phi = rng.uniform(0.2, 1.0, (2, MEASURED_POINTS)), rng.uniform(0.0, 6.28, MEASURED_POINTS)
        sine = np.sqrt(1.0 - cosine**2)
        wi = np.column_stack([sine[0], np.zeros(MEASURED_POINTS), cosine[0]])
        wo = np.column_stack([sine[1] * np.cos(phi), sine[1] * np.sin(phi), cosine[1]])
        noise = 1.0 + 0.005 * rng.standard_normal(MEASURED_POINTS)
        return PtfeShape.fitted(wi, wo, 1.01 * plate.factor(wi, wo) * noise)

    def session(self, rng: np.random.Generator) -> tuple[xr.Dataset, Model]:
        """Draw and reduce one session of one pose."""
        rig = self.rig
        reference, truth, ticks, stated = self.white(rng)
        material = drawn_material(rng)
        geometry = pixel_geometry(rig, truth.angles_rad)
        light = np.where(geometry.on_sample, irradiance(rig, geometry), 0.0)
        wi, wo = np.nan_to_num(geometry.wi), np.nan_to_num(geometry.wo)
        flat = (wi.reshape(-1, 3), wo.reshape(-1, 3))
        f_r = np.nan_to_num(material.evaluate(*flat)).reshape(SIDE_PX, SIDE_PX, -1)
        f_r = np.take_along_axis(f_r, self.channel.channel[..., np.newaxis], axis=2)[..., 0]
        factor = truth.rho * truth.shape.factor(wi, wo) * (1.0 + truth.rest)
        white = np.nan_to_num(factor) / np.pi * light
        sample = f_r * light
        images = PoseImages(*(image(each, FULL_DN / each.max(), rng, stated) for each in (sample, white)))
        u_joint = joint_resolution(rig)
        reduced = reduce_pose(rig, images, self.channel, reference, u_joint_rad=u_joint, options=Options())
        pose = ReducedPose(0, 0, ticks, reduced)
        return assemble(rig, [pose], CHANNELS, options=Options()), material


def sessions(number: int, *, measured: bool, seed: int) -> Iterator[tuple[Array, Array, float]]:
    """Draw sessions: errors and stated uncertainties of the samples, and the pull of their mean."""
    study = Study(measured=measured)
    for index in range(number):
        samples, material = study.session(np.random.default_rng((seed, index)))
        f_r = samples["f_r"].to_numpy()
        truth = np.broadcast_to(
            material.evaluate(samples["wi"].to_numpy(), samples["wo"].to_numpy()), f_r.shape
        )
        parts = components(samples, material)
        used = np.isfinite(f_r)
        u = u_of_samples(parts)
        error = np.where(used, f_r - truth, 0.0)
        # Relative to the truth: a mean over samples in which bright ones do not drown the others.
        weights = used / truth / np.count_nonzero(used)
        pull = float(np.sum(weights * error)) / u_of_combination(parts, weights)
        yield error[used], u[used], pull


def study(number: int, *, measured: bool, seed: int) -> tuple[float, float, float]:
    """Coverage of samples in percent, its standard error, and the coverage of sessions' means."""
    held, means = [], []
    for error, u, pull in sessions(number, measured=measured, seed=seed):
        held.append(float(np.mean(np.abs(error) <= K95 * u)))
        means.append(abs(pull) <= K95)
    coverage = np.array(held)
    return (
        100.0 * float(coverage.mean()),
        100.0 * float(coverage.std()) / np.sqrt(number),
        100.0 * float(np.mean(means)),
    )


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - a part's interface; there is nothing to draw
    """Draw all sessions; see the module."""
    rows = []
    for seed, measured in enumerate((True, False)):
        name = "white with measured points" if measured else "generic white"
        coverage, error, of_means = study(SESSIONS // 2, measured=measured, seed=seed)
        rows += [
            row(f"coverage of 95 % intervals, {name}: off 95 %", abs(coverage - 95.0), "%", 1.0),
            row(f"coverage of 95 % intervals, {name}", coverage, "%"),
            row(f"its standard error, {name}", error, "%"),
            row(f"coverage of sessions' means, {name}", of_means, "%"),
        ]
    return rows
