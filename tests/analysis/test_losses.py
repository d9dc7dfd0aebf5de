"""Losses and metrics: the documented formulas, their slopes, and data that break logarithms."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.losses import LOSSES, make_loss
from analysis.metrics import goodness
from rig.errors import BadInput

DATA = np.array([[0.0, 0.2], [1.5, -0.003], [30.0, np.nan]])
USED = np.isfinite(DATA)
COS_I = np.array([[1.0], [0.5], [0.1]])
U = np.full(DATA.shape, 0.02)


def test_residuals_are_the_documented_ones():
    """Catches a cosine in the wrong place or a logarithm of the wrong thing."""
    f = np.array([[0.1, 0.1], [2.0, 0.1], [20.0, 5.0]])
    clean = np.where(USED, DATA, 0.0)
    expected = {
        "chi2": (f - clean) / U,
        "log": np.log(1.0 + f * COS_I) - np.log(1.0 + clean * COS_I),
        "l2": (f - clean) * COS_I,
    }
    for name, residual in expected.items():
        ours = make_loss(name, DATA, USED, COS_I, U).residual(f)
        np.testing.assert_allclose(ours, np.where(USED, residual, 0.0), rtol=1e-12, atol=1e-15)
    cbrt = make_loss("cbrt", DATA, USED, COS_I, U).residual(f)
    assert cbrt[1, 0] == pytest.approx(np.cbrt(1.0) - np.cbrt(0.75), rel=1e-12)


@pytest.mark.parametrize("name", LOSSES)
def test_slopes(name):
    """Catches a slope that sends the solver the wrong way, or one that is infinite at zero."""
    loss = make_loss(name, DATA, USED, COS_I, U)
    f = np.array([[0.0, 0.1], [2.0, 1e-5], [20.0, 5.0]])
    step = 1e-7
    numeric = (loss.residual(f + step) - loss.residual(f - step)) / (2.0 * step)
    np.testing.assert_allclose(loss.slope(f), numeric, rtol=1e-5, atol=1e-8)
    assert np.all(np.isfinite(loss.weight()))
    assert loss.weight()[2, 1] == 0.0
    assert loss.linear == (name in {"chi2", "l2"})


def test_a_datum_below_minus_one_does_not_break_the_logarithm():
    """Catches a NaN from one noisy reading that ends the whole fit."""
    loss = make_loss("log", np.array([[-5.0]]), np.ones((1, 1), bool), np.ones((1, 1)), None)
    with np.errstate(all="raise"):
        assert np.isfinite(loss.residual(np.array([[0.1]]))).all()


def test_chi2_needs_uncertainties():
    """Catches division by zero, and a default that silently becomes another loss."""
    with pytest.raises(BadInput, match="log, cbrt or l2"):
        make_loss("chi2", DATA, USED, COS_I, None)
    with pytest.raises(BadInput, match="sample 1"):
        make_loss("chi2", DATA, USED, COS_I, np.array([[0.1, 0.1], [0.0, 0.1], [0.1, 0.0]]))
    with pytest.raises(BadInput, match="chi2, log, cbrt, l2"):
        make_loss("huber", DATA, USED, COS_I, None)


def test_metrics_are_the_documented_ones():
    """Catches a metric that is not the one whose name it carries."""
    sin = np.array([0.0, 0.6, 0.8])
    wi = np.stack([sin, 0.0 * sin, np.sqrt(1.0 - sin**2)], axis=1)
    wo = wi[::-1]
    data = np.array([[1.0], [2.0], [0.0]])
    fitted = np.array([[1.5], [1.0], [0.2]])
    used = np.array([[True], [True], [True]])
    x = wi[:, 2:]
    ours = goodness(fitted, data, used, wi=wi, wo=wo, uncertainty=np.full((3, 1), 0.5), parameters=1)
    assert ours["rms_log"] == pytest.approx(
        np.sqrt(np.mean((np.log1p(fitted * x) - np.log1p(data * x)) ** 2))
    )
    assert ours["l2_cos"] == pytest.approx(0.8)
    assert ours["rms_cbrt"] == pytest.approx(np.sqrt(np.mean((np.cbrt(fitted * x) - np.cbrt(data * x)) ** 2)))
    assert ours["median_relative"] == pytest.approx(0.5)
    assert ours["chi2_dof"] == pytest.approx((1.0 + 4.0 + 0.16) / 2.0)
    without = goodness(fitted, data, used & (data < 0.5), wi=wi, wo=wo)
    assert np.isnan(without["median_relative"])
    assert "chi2_dof" not in without
