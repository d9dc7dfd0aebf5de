"""The loss that writers return: would catch one that is not computed, or metadata dropped without a word."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.formats import NAMES, loss
from analysis.samples import make_samples, write
from rig.angles import spherical_to_direction


def grid_samples(channels=("550nm",)):
    """Make samples on a grid that every format can take, one of them flagged."""
    theta_i, theta_o, phi_o = np.meshgrid(
        np.radians([10.0, 14.0, 18.0]),
        np.radians(np.arange(0.0, 81.0, 8.0)),
        np.radians(np.arange(0.0, 360.0, 20.0)),
        indexing="ij",
    )
    wi = spherical_to_direction(theta_i.ravel(), 0.0)
    wo = spherical_to_direction(theta_o.ravel(), phi_o.ravel())
    f_r = np.repeat((0.2 + wi[:, 2] * wo[:, 2])[:, None], len(channels), axis=1)
    return make_samples(
        wi, wo, f_r, channels=list(channels), u_noise=0.01 * f_r, source_solid_angle_sr=1e-3, source="grid"
    )


SUFFIXES = (".nc", ".csv", ".astm", ".ssdd", ".bsdf", ".binary", ".zemax.bsdf", ".fred.txt")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_writer_returns_it(tmp_path, suffix):
    """Catches a writer that returns nothing, or forgets that uncertainty and solid angles are lost."""
    samples = grid_samples()
    if suffix == ".ssdd":  # a grid has one normal
        samples = samples.isel(sample=np.flatnonzero(samples["wo"].to_numpy()[:, 2] < 1.0))
    told = write(samples, tmp_path / f"out{suffix}")
    assert isinstance(told, loss.Loss)
    assert told.samples == samples.sizes["sample"]
    assert ("u_noise" in told.dropped) == (suffix != ".nc")
    assert ("source_solid_angle_sr" in told.dropped) == (suffix != ".nc")
    assert (told.cells > 0) == (suffix in {".bsdf", ".binary", ".zemax.bsdf"})
    assert "flags" not in told.dropped
    assert "\n" not in str(told)


def test_no_writer_is_without_a_test():
    """Catches a new writer that the test above does not know."""
    import importlib

    modules = [importlib.import_module(f"analysis.formats.{name}") for name in NAMES]
    suffixes = {module.SUFFIX for module in modules if hasattr(module, "SUFFIX")}
    assert suffixes == {*SUFFIXES, ".pab"}


def test_flagged_samples_are_counted(tmp_path):
    """Catches samples that vanish in silence."""
    samples = grid_samples()
    samples["flags"][:7] = 1
    told = write(samples, tmp_path / "out.csv")
    assert told.samples == samples.sizes["sample"] - 7
    assert "7 samples that are flagged or without a value" in told.dropped
    assert "flags" in told.dropped
    assert "7 samples" in str(told)


def test_errors_are_told_off_the_peak_and_at_the_worst_place():
    """Catches percentiles of something else, and a worst place that is another sample's."""
    samples = grid_samples()
    wi, wo, f_r = (samples[name].to_numpy() for name in ("wi", "wo", "f_r"))
    back = 1.01 * f_r
    back[100] = 3.0 * f_r[100]
    told = loss.compared(samples, wi, wo, f_r, back, cells=10, filled=4)
    assert told.median_relative == pytest.approx(0.01)
    assert told.p95_relative == pytest.approx(0.01)
    assert told.worst_relative == pytest.approx(2.0)
    assert told.where_worst == f"{loss.place_of(wi[100], wo[100])}, channel 550nm"
    assert told.filled_part == 0.4
