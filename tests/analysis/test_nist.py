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


def test_lanczos1_is_beyond_double_precision(shared_data, nist):
    """Catches an excuse that is none: the data's own rounding must be as large as the residuals."""
    reference = nist.read_reference(nist.DATA / "Lanczos1.dat")
    model = nist.MODELS["Lanczos1"]
    residual = nist.Projected(model, reference).residual(reference.values[[k - 1 for k in model.searched]])
    rounding = 2.0**-53 * abs(reference.y).max()
    assert abs(residual).max() < 1e4 * rounding


def test_digits(nist):
    """Catches a score that counts a wrong result as right."""
    certified = np.array([2.0, -3.0])
    assert nist._digits(np.array([2.0 + 2e-6, -3.0]), certified) == pytest.approx(6.0, abs=0.01)
    assert nist._digits(np.array([np.nan, -3.0]), certified) == 0.0
    assert nist._digits(np.array([2.0, 3.0]), certified) == 0.0
