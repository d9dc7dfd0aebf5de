"""The measurement equation against surfaces whose f_r is known in closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from analysis.measurement import Image, Mosaic, Options, PoseImages, reduce_pose
from analysis.models import MODELS
from analysis.reduce import SPOILED_POSE, ReducedPose, assemble, joint_resolution
from analysis.white import LambertianWhite
from capture.merge import Flag
from rig.kinematics import Kinematics
from rig.pixels import irradiance, pixel_geometry

if TYPE_CHECKING:
    from collections.abc import Callable

    from analysis.measurement import PoseSamples
    from analysis.models.base import Model
    from rig.description import Rig

CFA = np.array([[0, 1], [1, 2]])
NAMES = ("R", "G", "B")
WHITE = MODELS["lambert"](kd=0.99)
SURFACES = {
    "lambert": MODELS["lambert"](kd=(0.6, 0.3, 0.1)),
    "cook-torrance": MODELS["cook-torrance"](kd=(0.2, 0.1, 0.05), ks=0.8, m=0.2, ior=1.5),
}
POSES_DEG = [(20.0, -5.0), (45.0, 45.0), (45.0, 30.0), (70.0, 68.0), (30.0, -60.0)]


def _angles(rig: Rig, theta_i_deg: float, theta_o_deg: float) -> np.ndarray:
    """Joint angles of a pose in the plane of incidence, camera angle positive on the mirror's side."""
    ti, to = np.deg2rad([theta_i_deg, theta_o_deg])
    return Kinematics(rig).solve([np.sin(ti), 0.0, np.cos(ti)], [-np.sin(to), 0.0, np.cos(to)])


def _image(rig: Rig, model: Model, angles: np.ndarray, *, true: np.ndarray | None = None) -> Image:
    """Show a surface to a noise-free camera with uneven pixels."""
    geometry = pixel_geometry(rig, angles if true is None else true)
    light = irradiance(rig, geometry)
    with np.errstate(invalid="ignore"):
        values = model.evaluate(geometry.wi, geometry.wo) * light[..., None]
    channel = Mosaic.repeat(CFA, NAMES, light.shape).channel
    picked = np.take_along_axis(np.broadcast_to(values, (*light.shape, 3)), channel[..., None], axis=-1)[
        ..., 0
    ]
    gain = 5e4 * (1 + 0.01 * np.random.default_rng(3).standard_normal(light.shape))
    seen = np.where(geometry.on_sample, picked, 0.0)
    flags = np.zeros(light.shape, dtype=np.uint8)
    return Image(seen * gain, np.full(light.shape, 1e-6), flags, angles)


@pytest.fixture
def reduce_one(default_rig: Rig) -> Callable[..., PoseSamples]:
    """Reduce one pose of the default machine."""

    def reduce(images: PoseImages, **options: float) -> PoseSamples:
        rig = default_rig
        mosaic = Mosaic.repeat(CFA, NAMES, (rig.camera.height_px, rig.camera.width_px))
        return reduce_pose(
            rig,
            images,
            mosaic,
            LambertianWhite.of(rig),
            u_joint_rad=joint_resolution(rig),
            options=Options(**options),
        )

    return reduce


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("pose_deg", POSES_DEG)
def test_known_surfaces_come_back(
    default_rig: Rig, reduce_one: Callable[..., PoseSamples], name: str, pose_deg: tuple[float, float]
) -> None:
    """Catches a missing cosine or 1/r^2, a wrong pi, directions of the wrong pixel, channels mixed up."""
    angles, model = _angles(default_rig, *pose_deg), SURFACES[name]
    samples = reduce_one(
        PoseImages(_image(default_rig, model, angles), _image(default_rig, WHITE, angles)), max_theta_deg=89
    )
    expected = model.evaluate(samples.wi, samples.wo)
    used = samples.dropped == 0
    assert used.mean() > 0.9
    error = np.abs(samples.f_r / expected - 1)[used]
    # Near grazing an 8-pixel bin is wide and its curvature shows; it has to be stated then.
    assert (error < np.maximum(1e-4, 2 * (samples.u_binning / expected)[used])).mean() > 0.95
    assert error.max() < 4e-4


def test_stated_binning_error_covers_the_real_one(
    default_rig: Rig, reduce_one: Callable[..., PoseSamples]
) -> None:
    """Catches a binning term that is far off the difference between a large bin and its centre."""
    angles, model = _angles(default_rig, 40.0, 44.0), replace(SURFACES["cook-torrance"], m=0.05)
    images = PoseImages(_image(default_rig, model, angles), _image(default_rig, WHITE, angles))
    samples = reduce_one(
        replace(images, sample=replace(images.sample, variance=np.zeros((96, 128)))), bin_px=16
    )
    error = np.abs(samples.f_r - model.evaluate(samples.wi, samples.wo))
    assert np.median(error) > 1e-4
    ratio = np.sqrt(np.mean(error**2) / np.mean(samples.u_binning**2))
    assert 0.3 < ratio < 1.5


def test_white_at_another_pose_uses_its_own_geometry(
    default_rig: Rig, reduce_one: Callable[..., PoseSamples]
) -> None:
    """Catches the sample's cosine applied to the white, and joints that moved without stated uncertainty."""
    angles = _angles(default_rig, 60.0, 30.0)
    moved = angles + np.deg2rad([0.5, 0.0, 0.0, 0.0])
    model = SURFACES["lambert"]
    samples = reduce_one(PoseImages(_image(default_rig, model, angles), _image(default_rig, WHITE, moved)))
    expected = model.evaluate(samples.wi, samples.wo)
    np.testing.assert_allclose(samples.f_r, expected, rtol=1e-6)
    same = reduce_one(PoseImages(_image(default_rig, model, angles), _image(default_rig, WHITE, angles)))
    tangent = np.tan(np.deg2rad(60.0)) * joint_resolution(default_rig)[0] * np.sqrt(2)
    extra = np.sqrt(samples.u_white**2 - same.u_white**2) / samples.f_r
    assert np.median(extra) == pytest.approx(tangent, rel=0.05)


def test_flags_keep_pixels_out_and_dark_ones_in(
    default_rig: Rig, reduce_one: Callable[..., PoseSamples]
) -> None:
    """Catches hot or inconsistent pixels inside a sum, and dark bins that lose their negative pixels."""
    angles, model = _angles(default_rig, 45.0, 20.0), SURFACES["lambert"]
    image, white = _image(default_rig, model, angles), _image(default_rig, WHITE, angles)
    bad = np.random.default_rng(8).random(image.flags.shape) < 0.04
    kind = np.random.default_rng(9).choice([Flag.HOT, Flag.INCONSISTENT, Flag.NEAR_CLIPPED_USED], bad.shape)
    spoilt = replace(
        image,
        radiance=np.where(bad, 9e9, image.radiance),
        flags=np.where(bad, kind, Flag.UNDER_RANGE | Flag.NEIGHBOUR_CLIPPED).astype(np.uint8),
    )
    samples = reduce_one(PoseImages(spoilt, white))
    used = samples.dropped == 0
    assert used.mean() > 0.97
    np.testing.assert_allclose(samples.f_r[used], model.evaluate(samples.wi, samples.wo)[used], rtol=1e-6)
    assert samples.pixel_flags["hot"] == np.count_nonzero(bad & (kind == Flag.HOT))


def test_stray_light_is_taken_off_both(default_rig: Rig, reduce_one: Callable[..., PoseSamples]) -> None:
    """Catches a trap subtracted from the sample only, or added, or taken to be blacker than it is."""
    angles, model = _angles(default_rig, 45.0, 20.0), SURFACES["lambert"]
    image, white = _image(default_rig, model, angles), _image(default_rig, WHITE, angles)
    own = default_rig.trap.rho / default_rig.white.rho * white.radiance
    stray = replace(image, radiance=700.0 + own)
    lifted = [replace(part, radiance=part.radiance + 700.0) for part in (image, white)]
    clean = reduce_one(PoseImages(image, white))
    mended = reduce_one(PoseImages(*lifted, trap=stray))
    np.testing.assert_allclose(mended.f_r, clean.f_r, rtol=1e-9)
    assert (mended.u_noise > clean.u_noise).all()


def test_stated_noise_is_the_scatter(default_rig: Rig, reduce_one: Callable[..., PoseSamples]) -> None:
    """Catches variance of sums taken for that of means, and noise of sample and white mixed up."""
    angles, model = _angles(default_rig, 30.0, 10.0), SURFACES["lambert"]
    rng, pulls = np.random.default_rng(5), []
    clean = [_image(default_rig, surface, angles) for surface in (model, WHITE)]
    for _ in range(12):
        noisy = [
            replace(
                image,
                radiance=image.radiance + rng.normal(0, np.sqrt(variance), image.radiance.shape),
                variance=np.full(image.radiance.shape, variance),
            )
            for image, variance in zip(clean, (4e4, 9e4), strict=True)
        ]
        samples = reduce_one(PoseImages(*noisy))
        difference = samples.f_r - model.evaluate(samples.wi, samples.wo)
        pulls.append(difference / np.hypot(samples.u_noise, samples.u_white))
    pull = np.concatenate(pulls)
    assert abs(pull.std() - 1) < 0.03
    assert abs(pull.mean()) < 4 / np.sqrt(pull.size)


def test_joint_columns_predict_a_turned_joint(
    default_rig: Rig, reduce_one: Callable[..., PoseSamples]
) -> None:
    """Catches wrong signs or scales of the pose columns: they must predict what a hidden half tick does."""
    angles = _angles(default_rig, 40.0, 62.0)
    model = SURFACES["cook-torrance"]
    for joint in range(4):
        offset = np.eye(4)[joint] * 4e-4
        true = angles + offset
        sample, white = (_image(default_rig, surface, angles, true=true) for surface in (model, WHITE))
        samples = reduce_one(PoseImages(sample, white))
        pairs = ((samples.wi, samples.d_wi), (samples.wo, samples.d_wo))
        moved = [direction + 4e-4 * change[:, joint] for direction, change in pairs]
        at_measured = model.evaluate(samples.wi, samples.wo)
        predicted = model.evaluate(*moved) / at_measured - 1
        found = samples.f_r / at_measured - 1
        assert np.nanmax(np.abs(found - predicted)) < 1.5e-4
        if joint in {0, 2}:
            assert np.abs(predicted).max() > 5e-4


def test_assembled_table_states_everything(default_rig: Rig, reduce_one: Callable[..., PoseSamples]) -> None:
    """Catches white groups shared by different bins, lost solid angles, mixed poses, a table that varies."""
    parts = []
    for number, pose in enumerate([(45.0, 20.0), (60.0, 10.0)]):
        angles = _angles(default_rig, *pose)
        images = PoseImages(
            _image(default_rig, SURFACES["lambert"], angles), _image(default_rig, WHITE, angles)
        )
        parts.append(ReducedPose(number, number, (1, 2, 3, 4 + number), reduce_one(images)))
    table = assemble(default_rig, parts, NAMES, options=Options(), source="test")
    groups = table["white_group"].to_numpy()
    assert np.unique(groups).size == groups.size
    assert table["pose"].to_numpy().tolist() == [0] * len(parts[0].samples.wi) + [1] * len(
        parts[1].samples.wi
    )
    assert table.attrs["source_solid_angle_sr"] == pytest.approx(np.pi * 2.5**2 / 500**2, rel=1e-4)
    assert table["u_reference"].to_numpy() == pytest.approx(table["f_r"].to_numpy() * 0.0005 / 0.99)
    shared = assemble(default_rig, [parts[0], replace(parts[1], white_number=0)], NAMES, options=Options())
    common = set(shared["white_group"].to_numpy()[shared["pose"] == 0]) & set(
        shared["white_group"].to_numpy()[shared["pose"] == 1]
    )
    assert len(common) > 150
    marked = assemble(default_rig, [parts[0], replace(parts[1], spoiled=True)], NAMES, options=Options())
    spoiled = (table["pose"] == 1).to_numpy()
    bits = marked["flags"].to_numpy() - table["flags"].to_numpy()
    assert (bits == np.where(spoiled, SPOILED_POSE, 0)[:, None]).all()
    assert np.array_equal(marked["f_r"], table["f_r"], equal_nan=True)
    assert table.identical(assemble(default_rig, parts, NAMES, options=Options(), source="test"))


def test_a_white_of_half_the_reflectance_halves_f(default_rig: Rig) -> None:
    """Catches a reference whose table is read but not used."""
    angles = _angles(default_rig, 45.0, 20.0)
    mosaic = Mosaic.repeat(CFA, NAMES, (96, 128))
    images = PoseImages(_image(default_rig, WHITE, angles), _image(default_rig, WHITE, angles))
    values = [
        reduce_pose(
            default_rig,
            images,
            mosaic,
            LambertianWhite(rho, 0.01),
            u_joint_rad=joint_resolution(default_rig),
        )
        for rho in (0.8, 0.4)
    ]
    np.testing.assert_allclose(values[0].f_r, 2 * values[1].f_r)
    np.testing.assert_allclose(values[1].u_reference, values[1].f_r * 0.01 / 0.4)
