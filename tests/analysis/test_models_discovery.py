"""A new model is one file in the folder of models: it is found, fitted by its name, and clashes are told."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import analysis.models
from analysis.fit import fit
from analysis.models import MODELS, discover
from analysis.samples import make_samples
from benchmarks.models_digits import directions

ONE_FILE = '''
"""A lobe in the cosine of the half vector's angle, squared times a width."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from analysis.models.base import KD, KS, Kind, Lobe, Model, Parameter

STEEPNESS = Parameter("steepness", Kind.SHAPE, (0.1, 50.0), 0.0, 4.0, scan=(1.0, 10.0))


@dataclass(frozen=True, eq=False)
class Hill(Model):
    """f_r = kd/pi + ks exp(-steepness tan^2)."""

    kd: float = KD.default
    ks: float = KS.default
    steepness: float = STEEPNESS.default

    NAME: ClassVar[str] = "{name}"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, STEEPNESS)

    def lobe_at(self, geometry):
        value = np.exp(-np.asarray(self.steepness) * geometry.tan2_h)
        return Lobe(value, {{"steepness": -geometry.tan2_h * value}})
'''


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Return a function that writes the file of a model and discovers all models again."""
    before = set(sys.modules)
    monkeypatch.setattr(analysis.models, "__path__", [*analysis.models.__path__, str(tmp_path)])

    def write(name):
        (tmp_path / "hill_of_a_test.py").write_text(ONE_FILE.format(name=name), "utf-8")
        return discover(analysis.models.__path__)

    yield write
    for name in set(sys.modules) - before:
        if "hill_of_a_test" in name:
            del sys.modules[name]


def test_one_file_is_enough(written, monkeypatch):
    """Catches a list somewhere that a new model has to be added to before it can be fitted."""
    found = written("hill")
    assert set(found) == {*MODELS, "hill"}
    monkeypatch.setitem(MODELS, "hill", found["hill"])
    wi, wo = directions(60)
    samples = make_samples(wi, wo, found["hill"](kd=0.3, ks=0.2, steepness=7.0).evaluate(wi, wo))
    assert float(np.squeeze(fit(samples, "hill").model.steepness)) == pytest.approx(7.0, rel=1e-4)


def test_two_models_of_one_name_are_told(written):
    """Catches a new file that silently takes the place of an old model."""
    with pytest.raises(ValueError, match="both called ggx"):
        written("ggx")
