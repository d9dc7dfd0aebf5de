"""Bins of pixels: ratios of sums with one centroid for all channels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.binning import Dropped, PixelSignals, bin_ratio, curvature, make_bins

SHAPE = (48, 64)
CFA = np.tile([[0, 1], [1, 2]], (SHAPE[0] // 2, SHAPE[1] // 2))


def _directions() -> tuple[np.ndarray, np.ndarray]:
    row, col = np.indices(SHAPE, dtype=float)
    wi = np.stack([0.3 + 4e-4 * row, 0.1 + 3e-4 * col, np.ones(SHAPE)], axis=-1)
    wo = np.stack([-0.2 + 3e-4 * col, 4e-4 * row, np.ones(SHAPE)], axis=-1)
    return tuple(v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (wi, wo))


def _pixels(value: np.ndarray, **changes: np.ndarray) -> PixelSignals:
    """Make an image of f = `value` under uneven light and pixel gains, noise-free unless changed."""
    wi, wo = _directions()
    gain = 1 + 0.02 * np.random.default_rng(1).standard_normal(SHAPE)
    light = wi[..., 2] * (1 + np.indices(SHAPE)[0] / 200)
    fields = {
        "signal": value * light * gain,
        "signal_variance": np.full(SHAPE, 1e-6),
        "reference": light * gain,
        "reference_variance": np.full(SHAPE, 1e-6),
        "weight": light,
        "usable": np.ones(SHAPE, bool),
        "clipped": np.zeros(SHAPE, bool),
        "wi": wi,
        "wo": wo,
    }
    return PixelSignals(**(fields | changes))


def _lobe(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    half = wi + wo
    tan2 = (half[..., 0] ** 2 + half[..., 1] ** 2) / half[..., 2] ** 2
    return 0.1 + np.exp(-tan2 / 0.1**2)


def test_a_lobe_comes_back_at_the_common_direction_in_every_channel() -> None:
    """Catches channels whose mosaic sites pull their value half a pixel away from the bin's direction."""
    wi, wo = _directions()
    binned = bin_ratio(_pixels(_lobe(wi, wo)), make_bins(*SHAPE, 8), CFA, 3, min_fill=0.5)
    expected = _lobe(binned.wi, binned.wo)[:, None]
    assert np.abs(binned.ratio / expected - 1).max() < 2e-4


def test_holes_do_not_move_a_value_off_its_direction() -> None:
    """Catches a hot pixel or a sample's edge that shifts one channel's centroid against the others."""
    wi, wo = _directions()
    usable = np.random.default_rng(2).random(SHAPE) > 0.1
    binned = bin_ratio(_pixels(_lobe(wi, wo), usable=usable), make_bins(*SHAPE, 8), CFA, 3, min_fill=0.5)
    expected = _lobe(binned.wi, binned.wo)[:, None]
    assert np.nanmax(np.abs(binned.ratio / expected - 1)) < 4e-4
    assert np.isfinite(binned.ratio).mean() > 0.95


def test_constant_is_exact_whatever_is_missing() -> None:
    """Catches a mean of ratios, or weights that differ between numerator and denominator."""
    usable = np.random.default_rng(3).random(SHAPE) > 0.3
    binned = bin_ratio(
        _pixels(np.full(SHAPE, 0.25), usable=usable), make_bins(*SHAPE, 8), CFA, 3, min_fill=0.4
    )
    kept = binned.dropped == 0
    assert kept.mean() > 0.9
    np.testing.assert_allclose(binned.ratio[kept], 0.25, rtol=1e-12)


def test_noise_is_stated_as_it_scatters_and_the_ratio_is_unbiased() -> None:
    """Catches wrong variance propagation through tilted weights, clipped negatives, and biased ratios."""
    rng, wi = np.random.default_rng(4), _directions()[0]
    bins, pulls, values = make_bins(*SHAPE, 8), [], []
    for _ in range(60):
        noise, white_noise = rng.normal(0, 0.03, (2, *SHAPE))
        clean = _pixels(np.full(SHAPE, 0.01))
        noisy = _pixels(
            np.full(SHAPE, 0.01),
            signal=clean.signal + noise,
            signal_variance=np.full(SHAPE, 0.03**2),
            reference=clean.reference + white_noise,
            reference_variance=np.full(SHAPE, 0.03**2),
        )
        binned = bin_ratio(noisy, bins, CFA, 3, min_fill=0.5)
        pulls.append((binned.ratio - 0.01) / np.hypot(binned.u_signal, binned.u_reference))
        values.append(binned.ratio)
    pulled = np.stack(pulls)
    assert wi.size  # the geometry is the same in every draw
    assert abs(pulled.std() - 1) < 0.03
    assert abs(pulled.mean()) < 4 / np.sqrt(pulled.size)
    assert (np.stack(values) < 0).any()


def test_one_clipped_pixel_empties_its_channel_only() -> None:
    """Catches a bin that goes on with the pixels that noise left under the clip level."""
    clipped = np.zeros(SHAPE, bool)
    clipped[8, 8] = True
    pixels = _pixels(np.full(SHAPE, 0.3), clipped=clipped, usable=~clipped)
    binned = bin_ratio(pixels, make_bins(*SHAPE, 8), CFA, 3, min_fill=0.5)
    bin_number = 1 * 8 + 1
    assert binned.dropped[bin_number].tolist() == [Dropped.OVER_RANGE, 0, 0]
    assert np.isnan(binned.ratio[bin_number, 0])
    assert np.isfinite(binned.wi[bin_number]).all()
    assert np.count_nonzero(binned.dropped) == 1


def test_bins_with_too_few_or_lopsided_pixels_are_dropped_and_named() -> None:
    """Catches values extrapolated from one corner of a bin, and bins with nothing in them."""
    usable = np.ones(SHAPE, bool)
    usable[:8, :8] = False
    usable[8:16, 2:8] = False
    binned = bin_ratio(
        _pixels(np.full(SHAPE, 0.3), usable=usable), make_bins(*SHAPE, 8), CFA, 3, min_fill=0.5
    )
    assert (binned.dropped[0] == Dropped.FEW_PIXELS).all()
    assert np.isnan(binned.wi[0]).all()
    assert (binned.dropped[8] == Dropped.FEW_PIXELS).all()
    red_on_one_side = np.ones(SHAPE, bool)
    red_on_one_side[8:16, 2:8] = CFA[8:16, 2:8] != 0
    binned = bin_ratio(
        _pixels(np.full(SHAPE, 0.3), usable=red_on_one_side), make_bins(*SHAPE, 8), CFA, 3, min_fill=0.2
    )
    assert binned.dropped[8].tolist() == [Dropped.LOPSIDED, 0, 0]


def test_a_white_without_signal_gives_no_value() -> None:
    """Catches a division by a black or negative white."""
    binned = bin_ratio(
        _pixels(np.full(SHAPE, 0.3), reference=np.full(SHAPE, -1e-3)),
        make_bins(*SHAPE, 8),
        CFA,
        3,
        min_fill=0.5,
    )
    assert (binned.dropped & Dropped.NO_REFERENCE).all()
    assert np.isnan(binned.ratio).all()


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 40), st.integers(1, 40), st.sampled_from([2, 4, 8]))
def test_layout_covers_whole_bins_only(height: int, width: int, size: int) -> None:
    """Catches partial bins at the image's far edges, and pixels counted twice."""
    bins = make_bins(height, width, size)
    inside = bins.index[bins.index >= 0]
    assert bins.shape == (height // size, width // size)
    assert (np.bincount(inside, minlength=bins.count) == size**2).all()


def test_curvature_of_a_parabola_and_of_noise() -> None:
    """Catches a wrong factor in the binning term, and noise that is taken for curvature."""
    row, col = np.indices((6, 9), dtype=float)
    flat = np.zeros((54, 1))
    parabola = (row**2 + 0 * col).reshape(-1, 1)
    np.testing.assert_allclose(curvature(parabola, flat, (6, 9)), 2 / 24)
    noise = np.random.default_rng(5).normal(0, 1, (54, 1))
    assert np.median(curvature(noise, flat + 1, (6, 9))) < 0.12
    assert (curvature(np.ones((2, 1)), np.zeros((2, 1)), (1, 2)) == 0).all()


@pytest.mark.parametrize("missing", [0, 20, 53])
def test_curvature_survives_missing_bins(missing: int) -> None:
    """Catches NaN from an empty neighbour that spreads into stated uncertainties."""
    values = np.linspace(0, 1, 54)[:, None] ** 2
    values[missing] = np.nan
    assert np.isfinite(curvature(values, np.full((54, 1), 1e-8), (6, 9))).all()
