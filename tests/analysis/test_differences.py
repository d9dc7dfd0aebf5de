"""Files side by side: what differs by more than chance."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from analysis.differences import differences


def fitted(alpha, kd, u=0.01):
    """Return what `differences` reads of a fit."""
    return SimpleNamespace(
        parameters={"alpha": np.array(alpha), "kd": np.array(kd)},
        u={"alpha": np.array(u), "kd": np.full(len(kd), u)},
        derived={},
    )


def test_two_files_by_hand():
    """Catches a wrong mean, spread or probability: 3 u of difference between two values is p = 0.0027."""
    apart = 3.0 * np.hypot(0.01, 0.01)
    alpha, red, green = differences([fitted(0.2, [0.1, 0.3]), fitted(0.2 + apart, [0.1, 0.3])])
    assert (alpha.parameter, alpha.channel) == ("alpha", None)
    assert (green.parameter, green.channel) == ("kd", 1)
    assert alpha.largest == pytest.approx(3.0)
    assert alpha.p_value == pytest.approx(0.0026998, rel=1e-3)
    assert alpha.mean == pytest.approx(0.2 + 0.5 * apart)
    assert alpha.mean_u == pytest.approx(0.01 / np.sqrt(2.0))
    assert alpha.differs
    assert not red.differs


def test_many_parameters_do_not_differ_by_chance():
    """Catches a bar that a table of hundred equal parameters passes somewhere nearly every time."""
    random = np.random.default_rng(0)
    called = 0
    for _ in range(200):
        files = [fitted(0.2, 0.1 + 0.01 * random.standard_normal(100)) for _ in range(3)]
        called += any(row.differs for row in differences(files))
    assert called <= 20


def test_what_is_not_determined_does_not_differ():
    """Catches an infinite uncertainty that becomes a difference, or a NaN that spreads."""
    files = [fitted(0.2, [0.1], np.inf), fitted(0.9, [0.7])]
    row = differences(files)[0]
    assert np.isnan(row.p_value)
    assert not row.differs
    assert row.largest == 0.0
    assert row.mean == 0.9
