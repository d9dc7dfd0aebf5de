"""Studies of the fit: a plain fit beside it, coverage of its intervals, random starts against its optimum."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def benchmark(name):
    """Load a module of the benchmarks."""
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", ROOT / "benchmarks" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["ggx", "cook-torrance-schlick"])
def test_beside_a_plain_fit(shared_data, name):
    """Catches a fit that is worse than four starts of scipy; `gonio bench fit` holds the speed."""
    bench = benchmark("fit")
    materials = bench.materials()
    ours, plain = bench.side_by_side([materials[m] for m in ("yellow-paint", "gray-plastic")], name)
    for our, other in zip(ours, plain, strict=True):
        assert our.rms <= 1.0001 * other.rms


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    """Catches an uncertainty wrong by a factor: the full study is slow."""
    cell = benchmark("fit_coverage").study(0.02, 0.2, draws=120)
    assert cell.warned == 0.0
    assert min(cell.coverage.values()) > 0.87
    assert sum(cell.coverage.values()) < 4.0
    assert abs(cell.bias) < 0.005


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_coverage_in_every_cell():
    """Catches intervals that hold the truth in less than 93 or more than 97 % of 2,000 draws."""
    rows = benchmark("fit_coverage").run(None)
    assert [row["name"] for row in rows if not row["ok"]] == []


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["ggx", "blinn-phong"])
def test_sparse_real_paint_has_its_best_lobe(shared_data, name):
    """Catches a scan that skips samples of a coarse grid: a lobe 140 times too sharp looks as good there."""
    bench = benchmark("fit_optimum")
    sets = bench.data_sets()
    assert len(sets) == 22
    assert bench.gap(sets["garnet_red"], name, 10) <= bench.BAR


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.timeout(3000)
@pytest.mark.parametrize(
    "name", ["ggx", "cook-torrance", "cook-torrance-schlick", "ward-duer", "blinn-phong"]
)
def test_no_random_start_finds_better_anywhere(shared_data, name):
    """Catches a better optimum, by 0.1 % of the loss, that one of 100 random starts reaches."""
    bench = benchmark("fit_optimum")
    worst, material = bench.worst_gap(bench.data_sets(), name, bench.MANY)
    assert worst <= bench.BAR, material
