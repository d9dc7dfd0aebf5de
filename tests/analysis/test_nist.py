"""NIST's certified nonlinear regressions through the search that all fits use."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def nist():
    """Load the benchmark, which holds the problems."""
    spec = importlib.util.spec_from_file_location("benchmark_nist", ROOT / "benchmarks" / "nist_strd.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.realdata
def test_certified_values_from_both_starts(shared_data, nist):
    """Catches a search that ends early, in another minimum, or with a Jacobian that is not one."""
    names = nist.problems()
    assert len(names) == 27
    found = {(name, start): nist.solve(name, start) for name in names for start in (0, 1)}
    assert {key for key, each in found.items() if each.parameters < nist.PARAMETER_DIGITS} == set()
    poor = {name for (name, _), each in found.items() if each.deviations < nist.DEVIATION_DIGITS}
    assert poor == set(nist.BEYOND_DOUBLE)


@pytest.mark.realdata
@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="long double is double here")
def test_residuals_alone_are_beyond_double_precision(shared_data, nist):
    """Catches an excuse that is none: with better residuals and all else in double, the digits are there."""
    for name in nist.BEYOND_DOUBLE:
        found = [nist.solve(name, start) for start in (0, 1)]
        assert max(each.deviations for each in found) < nist.DEVIATION_DIGITS
        assert min(each.extended_deviations for each in found) >= nist.DEVIATION_DIGITS


@pytest.mark.realdata
def test_linear_parameters_are_solved_for(shared_data, nist):
    """Catches a search that is given the linear parameters of a separable problem."""
    separable = [name for name in nist.problems() if nist.MODELS[name].linear]
    assert len(separable) == 25
    for name in separable:
        projected = nist.Projected(nist.MODELS[name], nist.read_reference(nist.DATA / f"{name}.dat"))
        searched = projected.reference.values[[k - 1 for k in nist.MODELS[name].searched]]
        # At the certified values of the others the certified linear ones must come out.
        certified = projected.reference.values[[k - 1 for k in nist.MODELS[name].linear]]
        np.testing.assert_allclose(projected.linear(searched)[1], certified, rtol=1e-5)


def test_digits(nist):
    """Catches a score that counts a wrong result as right."""
    certified = np.array([2.0, -3.0])
    assert nist._digits(np.array([2.0 + 2e-6, -3.0]), certified) == pytest.approx(6.0, abs=0.01)
    assert nist._digits(np.array([np.nan, -3.0]), certified) == 0.0
    assert nist._digits(np.array([2.0, 3.0]), certified) == 0.0
