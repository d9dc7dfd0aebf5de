"""A lens that bends: directions follow its model, and what is left of it is stated."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.binning import make_bins
from analysis.budget import Correlation, budget
from analysis.corrections import Correction
from analysis.lens import distortion_px, u_distortion_of
from analysis.measurement import Image, Mosaic, Options, PoseImages, reduce_pose
from analysis.models import MODELS
from analysis.reduce import ReducedPose, assemble, joint_resolution
from analysis.white import LambertianWhite
from rig.description import Camera, Rig, default_rig
from rig.kinematics import Kinematics
from rig.pixels import irradiance, pixel_geometry

SIDE_PX = 96
BENT = (-4.0, 0.4, 0.004, -0.003, 0.0)
GLOSSY = MODELS["cook-torrance"](kd=0.1, ks=0.6, m=0.15, ior=1.5)
CHANNELS = ("R", "G", "B")


def machine(distortion: tuple[float, ...] = BENT) -> Rig:
    """Return a machine whose camera sees the sample at a wide angle."""
    middle = (SIDE_PX - 1) / 2.0
    camera = Camera(
        distance_mm=120.0,
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        focal_length_px=260.0,
        principal_point_px=(middle, middle),
        distortion=distortion,  # type: ignore[arg-type]
    )
    return default_rig(camera=camera)


def relative_errors(rig: Rig, options: Options) -> tuple[np.ndarray, np.ndarray, dict[str, Correlation]]:
    """Reduce a pose of a glossy sample: errors over the truth, stated uncertainties, classes."""
    angles = Kinematics(rig).solve([0.6, 0.0, 0.8], [-0.5, 0.1, np.sqrt(0.74)])
    geometry = pixel_geometry(rig, angles)
    light = np.where(geometry.on_sample, irradiance(rig, geometry), 0.0)
    wi, wo = (np.nan_to_num(each).reshape(-1, 3) for each in (geometry.wi, geometry.wo))
    f_r = np.nan_to_num(GLOSSY.evaluate(wi, wo)[:, 0]).reshape(light.shape)
    flags = np.zeros(light.shape, dtype=np.uint8)
    sample, white = (
        Image(value * light, np.full(light.shape, 1e-12), flags, angles)
        for value in (f_r, rig.white.rho / np.pi)
    )
    mosaic = Mosaic.repeat(np.array(((0, 1), (1, 2))), CHANNELS, light.shape)
    reduced = reduce_pose(
        rig,
        PoseImages(sample, white),
        mosaic,
        LambertianWhite.of(rig),
        u_joint_rad=joint_resolution(rig),
        options=options,
    )
    samples = assemble(rig, [ReducedPose(0, 0, (0,) * 4, reduced)], CHANNELS, options=options)
    truth = GLOSSY.evaluate(samples["wi"].to_numpy(), samples["wo"].to_numpy())[:, :1]
    error = (samples["f_r"].to_numpy() / truth - 1.0)[:, 1]
    stated = np.zeros(len(error))
    if "u_distortion" in samples:
        stated = (samples["u_distortion"].to_numpy() / truth)[:, 1]
    classes = {line.name: line.correlation for line in budget(samples)}
    return error, stated, classes


def test_directions_follow_the_lens() -> None:
    """Would catch a lens that is not undone: percents beside a highlight."""
    error, stated, classes = relative_errors(machine(), Options(bin_px=2))
    assert np.nanmax(np.abs(error)) < 0.01
    assert classes["lens distortion"] is Correlation.CALIBRATION
    # A tenth of a pixel, the lens model's own uncertainty, is small.
    assert 1e-5 < np.nanmax(stated) < 0.01


def test_a_lens_that_is_left_in_is_stated_whole() -> None:
    """Would catch a switch that does nothing, and an effect that no column speaks of."""
    error, stated, _ = relative_errors(machine(), Options(bin_px=2, without=(Correction.LENS_DISTORTION,)))
    assert np.nanmax(np.abs(error)) > 0.1
    known = np.isfinite(error)
    assert np.mean(np.abs(error[known]) <= 2.0 * stated[known] + 0.01) > 0.95


def test_a_straight_lens_has_no_column() -> None:
    """Would catch an uncertainty of what is not there."""
    _, stated, classes = relative_errors(machine((0.0,) * 5), Options())
    assert not stated.any()
    assert "lens distortion" not in classes


def test_shifts_are_those_of_the_model() -> None:
    """Would catch rows for columns, and a sign: a barrel lens draws corners inwards."""
    rig = machine((-0.9, 0.0, 0.0, 0.0, 0.0))
    bins = make_bins(SIDE_PX, SIDE_PX, 8)
    row, column = distortion_px(rig, bins).reshape(2, *bins.shape)
    assert row[0, 0] == pytest.approx(column[0, 0], abs=1e-9)
    assert row[0, 0] < 0.0 < row[-1, 0]
    assert abs(row[0, 0]) > 10.0 * abs(row[bins.shape[0] // 2, bins.shape[1] // 2])


def test_gaps_take_the_largest_uncertainty() -> None:
    """Would catch a bin without neighbours whose lens error is nought."""
    bins = make_bins(SIDE_PX, SIDE_PX, 8)
    ratio = np.full((bins.count, 1), np.nan)
    ratio[:3, 0] = 1.0, 2.0, 4.0
    ratio[50, 0] = 3.0
    u = u_distortion_of(machine(), ratio, bins, 8, corrected=True)
    np.testing.assert_allclose(u[[0, 1, 2, 50], 0], np.array([1.0, 1.5, 2.0, 2.0]) * 0.1 / 8.0)
    assert np.isnan(u[4, 0])
