"""Every model and derivative against its source's formula in 50 digits, over the whole box of shapes."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.models import MODELS
from benchmarks import models_digits
from benchmarks.models_digits import EXCEPTED_TARGET, SLOPE_TARGET, VALUE_TARGET, directions, worst
from benchmarks.models_exact import FORMULAS


@pytest.mark.parametrize("name", MODELS)
def test_value_and_derivatives(name):
    """Catches a wrong formula or derivative, and digits lost at grazing angles or at a corner of the box.

    Warnings of numpy are errors here.
    """
    found = worst(name, directions(6), draws=6, every=4)
    assert found.value <= VALUE_TARGET, found.where["value"]
    assert found.excepted <= EXCEPTED_TARGET, found.where["excepted"]
    for shape, error in found.slopes.items():
        assert error <= SLOPE_TARGET, (shape, found.where[shape])
    assert set(found.slopes) == {p.name for p in MODELS[name].PARAMETERS}


def test_every_model_has_an_exact_formula():
    """Catches a model that is compared with nothing."""
    assert set(FORMULAS) == set(MODELS)


def test_the_comparison_sees_the_thirteenth_digit(monkeypatch):
    """Catches a comparison that cannot fail: a value 2e-12 and a derivative 2e-10 off must be seen."""
    true = MODELS["ggx"]

    class Off(true):
        def lobe_at(self, geometry):
            lobe = super().lobe_at(geometry)
            return lobe._replace(
                value=lobe.value * (1.0 + 2e-12),
                slopes={name: slope * (1.0 + 2e-10) for name, slope in lobe.slopes.items()},
            )

    monkeypatch.setitem(models_digits.MODELS, "ggx", Off)
    found = worst("ggx", directions(2), draws=1)
    assert found.value > VALUE_TARGET
    assert found.slopes["alpha"] > SLOPE_TARGET


@pytest.mark.parametrize("name", MODELS)
def test_the_length_of_a_direction_does_not_move_the_half_vector(name):
    """Catches a lobe that shifts where directions were stored in single precision."""
    wi, wo = directions(20)
    f = MODELS[name]().evaluate(wi, wo)
    longer = MODELS[name]().evaluate(wi * (1.0 + 6e-8), wo * (1.0 - 6e-8))
    np.testing.assert_allclose(longer, f, rtol=1e-5)


@pytest.mark.parametrize("name", MODELS)
def test_one_pair_is_enough(name):
    """Catches a model that needs an array of directions."""
    wi, wo = (direction[3] for direction in directions(4))
    many = MODELS[name]().evaluate(np.stack([wi, wi]), np.stack([wo, wo]))
    alone = MODELS[name]().evaluate(wi, wo)
    assert alone.shape == (1,)
    np.testing.assert_allclose(alone, many[0], rtol=1e-14)
    assert MODELS[name]().evaluate(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 1)
    slopes = MODELS[name]().derivatives(wi, wo)
    assert {slope.shape for slope in slopes.values()} == {(1,)}
