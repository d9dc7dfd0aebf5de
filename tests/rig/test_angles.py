"""Directions, angles, and their exact round trips."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.angles import (
    direction_to_spherical,
    from_half_difference,
    half_difference,
    half_vector,
    mirror,
    rotation,
    spherical_to_direction,
    unit,
    wrap,
)

if TYPE_CHECKING:
    from rig.angles import FloatArray

SMALL = [0.0, 1e-300, 1e-17, 1e-12, 1e-8, 1e-4]
thetas = st.one_of(
    st.floats(0.0, math.pi),
    st.sampled_from([s for e in SMALL for s in (e, math.pi / 2 - e, math.pi / 2 + e, math.pi - e)]),
)
phis = st.one_of(st.floats(-math.pi, math.pi), st.sampled_from([k * math.pi / 4 for k in range(-4, 5)]))


@st.composite
def directions(draw: st.DrawFn) -> FloatArray:
    """Directions anywhere, often at or near a pole or the horizon."""
    return spherical_to_direction(draw(thetas), draw(phis))


@st.composite
def pairs(draw: st.DrawFn) -> tuple[FloatArray, FloatArray]:
    """Pairs of directions, often equal, opposite, mirrored, or nearly so."""
    wi = draw(directions())
    wo = draw(st.one_of(directions(), st.sampled_from([wi, -wi, mirror(wi), -mirror(wi)])))
    nudge = draw(st.sampled_from([0.0, 1e-16, 1e-15, 1e-12, 1e-8, 1e-3]))
    return wi, unit(wo + nudge * draw(directions()))


@given(directions())
def test_direction_survives_spherical(w: FloatArray) -> None:
    """Catch digits lost at the poles and the horizon, and azimuths of the wrong quadrant."""
    theta, phi = direction_to_spherical(w)
    assert 0.0 <= theta <= math.pi
    assert -math.pi <= phi <= math.pi
    np.testing.assert_allclose(spherical_to_direction(theta, phi), w, rtol=0, atol=1e-15)


@given(st.floats(1e-9, 1e-2), phis)
def test_small_polar_angles_keep_their_digits(theta: float, phi: float) -> None:
    """Catch an arc cosine, which returns 0 for every angle below 1e-8."""
    recovered, _ = direction_to_spherical(spherical_to_direction(theta, phi))
    assert recovered == pytest.approx(theta, rel=1e-14, abs=0)


@pytest.mark.parametrize("z", [1.0, -1.0])
@pytest.mark.parametrize("x", [0.0, -0.0])
@pytest.mark.parametrize("y", [0.0, -0.0])
def test_azimuth_of_a_pole_is_zero(x: float, y: float, z: float) -> None:
    """Catch arctan2(0, -0) = pi, which turns the azimuth of the normal by half a turn."""
    theta, phi = direction_to_spherical([x, y, z])
    assert theta == (0.0 if z > 0 else math.pi)
    assert phi == 0.0


@given(pairs())
def test_pair_survives_half_difference(pair: tuple[FloatArray, FloatArray]) -> None:
    """Catch a wrong rotation order, lost digits near retro-reflection, and a half vector made of rounding."""
    wi, wo = pair
    theta_h, phi_h, theta_d, phi_d = half_difference(wi, wo)
    assert 0.0 <= theta_d <= math.pi / 2
    again_i, again_o = from_half_difference(theta_h, phi_h, theta_d, phi_d)
    np.testing.assert_allclose(again_i, wi, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again_o, wo, rtol=0, atol=1e-12)


@given(pairs())
def test_half_vector_is_half_way(pair: tuple[FloatArray, FloatArray]) -> None:
    """Catch a half vector nearer to one of the two, or one that is not of length one."""
    wi, wo = pair
    h = half_vector(wi, wo)
    assert np.linalg.norm(h) == pytest.approx(1.0, abs=1e-15)
    # Lengths that differ from one by rounding tell along the sum, the more the shorter it is.
    rounding = 4e-15 + 1.5e-15 / max(float(np.linalg.norm(wi + wo)), 0.1)
    assert h @ wi == pytest.approx(h @ wo, abs=rounding)
    assert h @ wi > -rounding


@given(pairs())
def test_swapping_light_and_camera_turns_phi_d_by_half(pair: tuple[FloatArray, FloatArray]) -> None:
    """Catch a difference angle that is not reciprocal: the swap must change phi_d by pi and nothing else."""
    forth, back = half_difference(*pair), half_difference(*pair[::-1])
    if np.linalg.norm(pair[0] + pair[1]) < 1e-9:
        return  # the half vector of opposite directions depends on the order of rounding
    np.testing.assert_allclose(back[:3], forth[:3], rtol=0, atol=1e-15)
    # The azimuth is only as sharp as the difference is long.
    turned = wrap(back[3] - forth[3] - math.pi) * math.sin(forth[2])
    assert turned == pytest.approx(0.0, abs=1e-14)


@given(st.floats(0.0, 1.5), phis, st.floats(1e-3, 1.5), phis)
def test_angles_survive_directions(theta_h: float, phi_h: float, theta_d: float, phi_d: float) -> None:
    """Catch conventions of half_difference and its inverse that agree on directions by two wrongs."""
    angles = half_difference(*from_half_difference(theta_h, phi_h, theta_d, phi_d))
    h, d = spherical_to_direction(theta_h, phi_h), spherical_to_direction(theta_d, phi_d)
    np.testing.assert_allclose(spherical_to_direction(*angles[:2]), h, rtol=0, atol=1e-12)
    assert angles[2] == pytest.approx(theta_d, abs=1e-14)
    if theta_h > 1e-6:  # at the pole phi_h is 0 by convention, and phi_d takes over its turn
        np.testing.assert_allclose(spherical_to_direction(*angles[2:]), d, rtol=0, atol=1e-8)


def test_difference_angles_by_hand() -> None:
    """Catch a sign or an order of rotations: a case computed on paper."""
    # Both lean towards +y, by 10 and 70 deg: the half vector by 40, the light 30 short of it.
    theta_h, phi_h, theta_d, phi_d = (
        math.degrees(a)
        for a in half_difference(
            spherical_to_direction(math.radians(10), math.pi / 2),
            spherical_to_direction(math.radians(70), math.pi / 2),
        )
    )
    assert (theta_h, phi_h, theta_d) == pytest.approx((40, 90, 30))
    assert abs(phi_d) == pytest.approx(180)  # the light leans back against the half vector's tilt


def test_half_difference_keeps_digits_in_retro_and_opposition() -> None:
    """Catch an arc cosine of wi . h; references have 50 digits."""
    with mpmath.workdps(50):
        for angle in (1e-12, 1e-7, 1e-3, math.pi - 1e-3, math.pi - 1e-7):
            exact = mpmath.mpf(angle) / 2
            theta_d = half_difference(spherical_to_direction(angle, 0.0), [0.0, 0.0, 1.0])[2]
            assert abs(float(theta_d) - float(exact)) <= 2.3e-16 * max(1.0, float(exact)) * 2
            if angle < 1.0:
                assert float(theta_d) == pytest.approx(float(exact), rel=1e-14, abs=0)


@pytest.mark.parametrize(
    ("wi", "h"),
    [
        ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
        ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]),
        ([0.0, 0.0, -1.0], [1.0, 0.0, 0.0]),
        ([0.6, 0.0, 0.8], [-0.8, 0.0, 0.6]),
        ([0.6, 0.0, -0.8], [0.8, 0.0, 0.6]),
    ],
)
def test_half_vector_of_opposite_directions(wi: list[float], h: list[float]) -> None:
    """Catch NaN, and a documented convention that the code does not keep."""
    np.testing.assert_allclose(half_vector(wi, -np.array(wi)), h, rtol=0, atol=1e-15)
    assert half_difference(wi, -np.array(wi))[2] == math.pi / 2


def test_coincident_on_the_normal_is_all_zero() -> None:
    """Catch NaN or a stray azimuth where light, camera and normal coincide."""
    normal = [0.0, 0.0, 1.0]
    assert [float(a) for a in half_difference(normal, normal)] == [0.0, 0.0, 0.0, 0.0]


@given(directions())
def test_coincident_directions_have_no_difference_azimuth(w: FloatArray) -> None:
    """Catch an azimuth made of rounding where light and camera coincide."""
    assert half_difference(w, w)[2:] == (0.0, 0.0)


def test_shapes_broadcast_and_nan_stays_in_its_place() -> None:
    """Catch flattened axes, and a NaN that spreads, raises or is replaced by a number."""
    rng = np.random.default_rng(3)
    wi = unit(rng.normal(size=(4, 1, 3)))
    wo = unit(rng.normal(size=(5, 3)))
    wi[1, 0, 2] = np.nan
    for angle in half_difference(wi, wo):
        assert angle.shape == (4, 5)
        assert np.array_equal(np.isnan(angle), np.isnan(wi[..., 2] + wo[:, 0]))
    assert half_vector(wi, wo).shape == (4, 5, 3)
    for pair in from_half_difference(*half_difference(wi, wo)):
        assert pair.shape == (4, 5, 3)
        assert np.all(np.isnan(pair[1]))
        assert np.all(np.isfinite(np.delete(pair, 1, axis=0)))
    theta, phi = direction_to_spherical([[np.nan, 0, 0], [0, np.nan, 0], [0, 0, np.nan], [0, 0, 1]])
    assert np.isnan(theta).tolist() == np.isnan(phi).tolist() == [True, True, True, False]
    assert np.isnan(spherical_to_direction([0.0, np.nan], 0.5)).all(axis=-1).tolist() == [False, True]
    assert np.isnan(spherical_to_direction(0.5, [0.0, np.nan])).all(axis=-1).tolist() == [False, True]


def test_empty_arrays_pass() -> None:
    """Catch reductions that fail on no samples at all."""
    none = np.empty((0, 3))
    assert half_vector(none, none).shape == (0, 3)
    assert [angle.shape for angle in half_difference(none, none)] == [(0,)] * 4
    assert unit(none).shape == (0, 3)


@given(directions(), st.sampled_from([1e-320, 1e-200, 1e-5, 1.0, 1e200, 1e308]))
def test_unit_of_any_length(w: FloatArray, length: float) -> None:
    """Catch squares that overflow or underflow."""
    tolerance = 1e-3 if length < 1e-300 else 1e-15  # denormals have few digits
    np.testing.assert_allclose(unit(w * length), w, rtol=0, atol=tolerance)


def test_unit_of_no_direction_is_nan() -> None:
    """Catch a warning, or a zero vector that passes as a direction."""
    assert np.isnan(unit([[0, 0, 0], [np.inf, 0, 0], [np.nan, 1, 0]])).all()
    assert np.isnan(half_vector([0, 0, 0], [0, 0, 0])).all()


@given(st.floats(-1e6, 1e6))
def test_wrap_keeps_the_angle(angle: float) -> None:
    """Catch the wrong end of the interval, and an angle moved by anything but whole turns."""
    wrapped = float(wrap(angle))
    assert -math.pi < wrapped <= math.pi
    turns = (angle - wrapped) / (2 * math.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)
    if -math.pi < angle <= math.pi:
        assert wrapped == angle


@given(st.integers(-1000, 1000), st.integers(-3, 3))
def test_wrap_near_odd_half_turns(half_turns: int, ulps: int) -> None:
    """Catch rounding that leaves the interval at one of its ends."""
    angle = (2 * half_turns + 1) * math.pi
    angle += ulps * math.ulp(angle)
    assert -math.pi < float(wrap(angle)) <= math.pi


def test_wrap_at_the_seam() -> None:
    """Catch -pi where +pi is the convention, one ulp inside and outside."""
    pi, inside = math.pi, math.nextafter(-math.pi, 0.0)
    assert wrap([pi, -pi, 3 * pi, inside]).tolist() == [pi, pi, pi, inside]
    assert np.isnan(wrap([np.nan, np.inf])).all()


@given(directions(), st.floats(-10, 10), directions())
def test_rotation_is_right_handed_and_rigid(axis: FloatArray, angle: float, v: FloatArray) -> None:
    """Catch a transposed matrix: against Rodrigues' formula in vectors, and as a rotation."""
    matrix = rotation(3.7 * axis, angle)
    cosine, sine = math.cos(angle), math.sin(angle)
    expected = v * cosine + np.cross(axis, v) * sine + axis * (axis @ v) * (1 - cosine)
    np.testing.assert_allclose(matrix @ v, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


def test_rotation_stacks() -> None:
    """Catch axes and angles that do not broadcast: one matrix per joint and pose."""
    axes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    angles = np.linspace(-1, 1, 10).reshape(5, 2)
    stacked = rotation(axes, angles)
    assert stacked.shape == (5, 2, 3, 3)
    np.testing.assert_array_equal(stacked[3, 1], rotation(axes[1], angles[3, 1]))
    # The convention that everything else rests on: positive elevation leans +z towards +x.
    np.testing.assert_allclose(rotation([0, 1, 0], math.pi / 2) @ [0, 0, 1], [1, 0, 0], atol=1e-16)


def test_mirror_is_the_mirror_direction() -> None:
    """Catch a mirror through the plane instead of about the normal."""
    wi = spherical_to_direction(0.7, 0.3)
    assert half_difference(wi, mirror(wi))[0] == pytest.approx(0.0, abs=1e-16)
    np.testing.assert_allclose(direction_to_spherical(mirror(wi)), (0.7, 0.3 - math.pi), rtol=1e-15)
