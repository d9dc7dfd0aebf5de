"""Every column of a reduction against GTC: who shares it, poses, places of the picture and channels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from analysis.budget import components, u_of_combination, u_of_samples
from analysis.samples import make_samples
from analysis.uncertainty import COMMON, IN_F, INDEPENDENT
from rig.angles import spherical_to_direction

CHANNELS = ("R", "G")
POSE = np.array([0, 0, 1, 1, 2])
PLACE = np.array([0, 1, 0, 1, 0])
WHITE_GROUP = np.array([0, 1, 0, 1, 2])
F_R = np.outer([0.31, 0.22, 0.17, 0.4, 0.09], [1.0, 0.7])
RNG = np.random.default_rng(4)
COLUMNS: dict[str, Any] = {name: F_R * RNG.uniform(0.001, 0.02, F_R.shape) for name in IN_F}
SHARED_BY = {
    **{f"u_{name}": np.zeros(5, dtype=np.intp) for name in COMMON},
    "u_white": WHITE_GROUP,
    "u_lamp": POSE,
    "u_flat": PLACE,
    "u_distortion": PLACE,
}


def measured() -> Any:
    """Five samples of three poses and two places, with every column that is in u_f_r."""
    theta = np.deg2rad([10.0, 20.0, 30.0, 40.0, 50.0])
    return make_samples(
        spherical_to_direction(theta, 0.0 * theta),
        spherical_to_direction(theta, 0.0 * theta + np.pi),
        F_R,
        channels=CHANNELS,
        pose=POSE,
        flat_group=PLACE,
        white_group=WHITE_GROUP,
        **COLUMNS,
    )


def oracle(only: tuple[str, ...]) -> list[list[Any]]:
    """Return the samples as uncertain numbers: each shared error is one input of GTC."""
    import GTC

    values: list[list[Any]] = [[float(f) for f in line] for line in F_R]
    for name in only:
        inputs: dict[tuple[int, ...], Any] = {}
        for sample in range(5):
            for channel in range(len(CHANNELS)):
                key: tuple[int, ...] = (sample, channel)
                if name not in INDEPENDENT:
                    key = (int(SHARED_BY[name][sample]), *((channel,) if name == "u_white" else ()))
                unit = inputs.setdefault(key, GTC.ureal(0.0, 1.0))
                values[sample][channel] += float(COLUMNS[name][sample, channel]) * unit
    return values


def test_every_column_is_held_against_the_oracle() -> None:
    """Would catch a new column that nobody has said who shares."""
    assert {*INDEPENDENT, *SHARED_BY} == set(IN_F)


@pytest.mark.parametrize("seed", range(4))
def test_combinations_of_all_columns_are_as_uncertain_as_gtc_says(seed: int) -> None:
    """Would catch a column whose error averages out over those who share it, or one left out."""
    weights = np.random.default_rng(seed).standard_normal(F_R.shape)
    values = oracle(IN_F)
    expected = sum(weights[s, c] * values[s][c] for s in range(5) for c in range(2))
    assert u_of_combination(components(measured()), weights) == pytest.approx(expected.u, rel=1e-9)


def test_samples_with_all_columns_are_as_uncertain_as_gtc_says() -> None:
    """Would catch a column that is counted twice or not at all."""
    expected = [[value.u for value in line] for line in oracle(IN_F)]
    assert u_of_samples(components(measured())) == pytest.approx(np.array(expected), rel=1e-9)
    assert measured()["u_f_r"].to_numpy() == pytest.approx(np.array(expected), rel=1e-9)
