"""The budget: correlations forgotten or invented, against GTC, against draws, and on a reduced session."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from analysis.budget import Correlation, budget, components, u_of_combination, u_of_samples
from analysis.models import MODELS
from analysis.samples import make_samples
from rig.angles import spherical_to_direction

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

# Four samples: signals over two whites; the white's reflectance is common to all.
SIGNAL = np.array([820.0, 640.0, 333.0, 90.0])
U_SIGNAL = np.array([4.0, 3.0, 2.5, 1.5])
WHITE = np.array([3100.0, 2500.0])
U_WHITE = np.array([9.0, 14.0])
OF_WHITE = np.array([0, 0, 1, 1])
RHO, U_RHO = 0.985, 0.004


def measured() -> xr.Dataset:
    """Four samples with the columns that a reduction states for that equation."""
    f_r = SIGNAL / WHITE[OF_WHITE] * RHO / np.pi
    theta = np.deg2rad([10.0, 25.0, 40.0, 60.0])
    column = {
        "u_noise": f_r * U_SIGNAL / SIGNAL,
        "u_white": f_r * (U_WHITE / WHITE)[OF_WHITE],
        "u_reference": f_r * U_RHO / RHO,
    }
    return make_samples(
        spherical_to_direction(theta, 0.0 * theta),
        spherical_to_direction(theta, 0.0 * theta + np.pi),
        f_r[:, np.newaxis],
        channels=["R"],
        white_group=OF_WHITE,
        **{name: values[:, np.newaxis] for name, values in column.items()},
    )


def oracle() -> list[Any]:
    """Return the same four samples as uncertain numbers of GTC."""
    import GTC

    rho = GTC.ureal(RHO, U_RHO)
    whites = [GTC.ureal(value, u) for value, u in zip(WHITE, U_WHITE, strict=True)]
    signals = [GTC.ureal(value, u) for value, u in zip(SIGNAL, U_SIGNAL, strict=True)]
    return [signal / whites[of] * rho / np.pi for signal, of in zip(signals, OF_WHITE, strict=True)]


@pytest.mark.parametrize(
    "weights",
    [
        (1.0, 0.0, 0.0, 0.0),
        (0.25, 0.25, 0.25, 0.25),
        (1.0, -1.0, 0.0, 0.0),
        (1.0, 0.0, -1.0, 0.0),
        (0.3, -2.0, 1.0, 5.0),
    ],
)
def test_combinations_are_as_uncertain_as_gtc_says(weights: tuple[float, ...]) -> None:
    """Sums whose common errors averaged out, differences whose common errors did not cancel."""
    expected = sum(weight * value for weight, value in zip(weights, oracle(), strict=True))

    found = u_of_combination(components(measured()), np.array(weights)[:, np.newaxis])

    assert found == pytest.approx(expected.u, rel=1e-9)


def test_samples_are_as_uncertain_as_gtc_says() -> None:
    """A component left out, or counted twice."""
    u = u_of_samples(components(measured()))

    assert u[:, 0] == pytest.approx([value.u for value in oracle()], rel=1e-9)
    assert measured()["u_f_r"].to_numpy() == pytest.approx(u, rel=1e-9)


def test_draws_have_the_covariance_that_is_stated() -> None:
    """Monte Carlo (JCGM 101): first order against the whole equation, for every pair of samples."""
    rng = np.random.default_rng(1)
    draws = 200_000
    signal = SIGNAL + U_SIGNAL * rng.standard_normal((draws, 4))
    white = WHITE + U_WHITE * rng.standard_normal((draws, 2))
    rho = RHO + U_RHO * rng.standard_normal((draws, 1))
    truth = np.cov((signal / white[:, OF_WHITE] * rho / np.pi).T)

    parts = components(measured())
    drawn = np.cov(np.array([sum(part.draw(rng)[:, 0] for part in parts) for _ in range(20_000)]).T)
    unit = np.eye(4)
    stated = np.array(
        [
            [
                (u_of_combination(parts, a + b) ** 2 - u_of_combination(parts, a - b) ** 2) / 4.0
                for b in unit[..., np.newaxis]
            ]
            for a in unit[..., np.newaxis]
        ]
    )

    scale = np.sqrt(np.outer(np.diag(truth), np.diag(truth)))
    assert np.abs(stated / scale - truth / scale).max() < 0.015
    assert np.abs(drawn / scale - truth / scale).max() < 0.04


def test_joints_are_errors_of_all_samples_at_a_step() -> None:
    """An angle's error that averages out over the pixels of a pose."""
    samples = measured()
    tangent = np.zeros((4, 1, 3))
    tangent[:, 0, 0] = 1.0
    samples["d_wi"] = (("sample", "joint", "xyz"), tangent)
    samples["d_wo"] = (("sample", "joint", "xyz"), 0.0 * tangent)
    samples["u_joint_rad"] = (("joint",), np.array([1e-3]))
    samples["pose"] = (("sample",), np.arange(4))
    samples["joint_group"] = (("sample", "joint"), np.array([[5], [5], [5], [9]]))
    model = MODELS["cook-torrance"](kd=0.1, ks=0.5, m=0.3, ior=1.5)

    *_, joint = components(samples, model)

    assert joint.correlation is Correlation.SESSION
    one = [joint.variance_of(np.eye(4)[index][:, np.newaxis]) for index in range(3)]
    together = joint.variance_of(np.array([1.0, 1.0, 1.0, 0.0])[:, np.newaxis])
    assert together == pytest.approx(sum(map(np.sqrt, one)) ** 2, rel=0.3)
    assert together > 1.5 * sum(one)


def test_budget_names_what_dominates() -> None:
    """A mean with the budget of a single sample: noise averages out, the white's reflectance does not."""
    samples = measured()
    lines = budget(samples)

    assert lines[0].name == "reflectance of the white"
    assert lines[0].correlation is Correlation.CALIBRATION
    assert lines[0].of_session == pytest.approx(U_RHO / RHO)
    assert sum(line.share_of_session for line in lines) == pytest.approx(1.0)
    noise = next(line for line in lines if line.correlation is Correlation.RANDOM)
    assert noise.of_session < noise.of_sample
    assert budget(samples.drop_vars(["u_f_r", "u_noise", "u_white", "u_reference"])) == []


def test_samples_without_values_have_no_weight() -> None:
    """NaN that eats the whole budget."""
    samples = measured()
    samples["f_r"][1, 0] = np.nan
    samples["u_noise"][1, 0] = np.nan

    assert all(np.isfinite(line.of_session) for line in budget(samples))
    assert np.isfinite(u_of_combination(components(samples), np.ones((4, 1))))
