"""The interface of all models, and the properties that a BRDF must have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.models import MODELS
from analysis.models.base import Coordinate, Kind
from rig.errors import BadInput


def direction(theta, phi):
    """Return unit vectors of polar angle theta and azimuth phi."""
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) * np.ones_like(phi)], axis=-1
    )


def pairs():
    """Return pairs of directions: random ones, and those at which formulas break."""
    random = np.random.default_rng(5)
    theta_i, theta_o = np.arccos(random.uniform(0.01, 1.0, (2, 20)))
    wi, wo = direction(theta_i, 0.0 * theta_i), direction(theta_o, random.uniform(-np.pi, np.pi, 20))
    mirror = wi * np.array([-1.0, -1.0, 1.0])
    near = mirror + 1e-3 * random.standard_normal(mirror.shape)
    near /= np.linalg.norm(near, axis=-1, keepdims=True)
    near[:, 2] = np.abs(near[:, 2])
    hard_i = direction(np.array([0.0, 1e-9, 0.7, 1.55, 1.5707, 1.55]), np.zeros(6))
    hard_o = direction(
        np.array([0.0, 0.0, 0.7, 1.55, 1.5707, 1.56]), np.array([0.0, 0.0, 0.0, np.pi, 0.0, 1.0])
    )
    return np.concatenate([wi, wi, wi, wi, hard_i]), np.concatenate([wo, mirror, near, wi, hard_o])


@pytest.mark.parametrize("name", MODELS)
def test_the_edges_of_the_domain(name):
    """Catches light through the surface, NaN swallowed or invented, and warnings at the horizon."""
    lit, grazing, below = [0.6, 0.0, 0.8], [1.0, 0.0, 1e-300], [0.0, 0.6, -0.8]
    missing, flat = [np.nan, 0.0, 1.0], [1.0, 0.0, 0.0]
    wi = np.array([lit, below, lit, missing, lit, flat, grazing, lit])
    wo = np.array([below, lit, missing, below, flat, lit, [-1.0, 0.0, 1e-300], lit])
    with np.errstate(all="raise"):
        f = MODELS[name]().evaluate(wi, wo)
        slopes = MODELS[name]().derivatives(wi, wo)
    for values in (f, *slopes.values()):
        assert np.all(values[[0, 1, 4, 5]] == 0.0)
        assert np.all(np.isnan(values[[2, 3]]))
        assert np.all(np.isfinite(values[[6, 7]]))
    assert np.all(f[[6, 7]] > 0.0)


@pytest.mark.parametrize("name", MODELS)
def test_shapes_broadcast(name):
    """Catches a model that only knows (N, 3), or mixes channels with samples."""
    wi, wo = pairs()
    model = MODELS[name]
    first = {p.name: p.default for p in model.PARAMETERS}
    second = {p.name: p.default * 1.3 for p in model.PARAMETERS}
    both = {key: np.array([first[key], second[key]]) for key in first}
    f = model(**both).evaluate(wi[:80].reshape(4, 20, 3), wo[:80].reshape(4, 20, 3))
    assert f.shape == (4, 20, 2)
    np.testing.assert_array_equal(f[..., 0].ravel(), model(**first).evaluate(wi[:80], wo[:80])[:, 0])
    np.testing.assert_array_equal(f[..., 1].ravel(), model(**second).evaluate(wi[:80], wo[:80])[:, 0])
    assert model(**first).evaluate(wi[0], wo[:5]).shape == (5, 1)
    one_shape = model(**(first | {"kd": [0.1, 0.2, 0.3]})).derivatives(wi, wo)
    assert {slope.shape for slope in one_shape.values()} == {(len(wi), 3)}


@pytest.mark.parametrize("name", MODELS)
def test_scales_times_basis_is_the_model(name):
    """Catches a basis that a linear solver would trust and that is not the model's."""
    wi, wo = pairs()
    model = MODELS[name]()
    scales = {p.name: p.default for p in model.PARAMETERS if p.kind is not Kind.SHAPE}
    columns = model.basis(wi, wo)
    assert set(columns) == set(scales)
    total = sum(scales[key] * columns[key] for key in columns)
    np.testing.assert_allclose(total, model.evaluate(wi, wo), rtol=1e-14)


@pytest.mark.parametrize("name", [name for name in MODELS if MODELS[name].RECIPROCAL])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_reciprocity_and_rotation(name, seed):
    """Catches an asymmetry between light and camera, or a lobe that knows where x is."""
    random = np.random.default_rng(seed)
    wi, wo = random.standard_normal((2, 50, 3))
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    wi, wo = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (wi, wo))
    model = MODELS[name]()
    f = model.evaluate(wi, wo)
    assert np.all(f >= 0.0)
    np.testing.assert_allclose(model.evaluate(wo, wi), f, rtol=1e-11)
    if not MODELS[name].ISOTROPIC:
        return
    angle = random.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    np.testing.assert_allclose(model.evaluate(wi @ turn.T, wo @ turn.T), f, rtol=1e-9)


@pytest.mark.parametrize("name", [name for name in MODELS if not MODELS[name].ISOTROPIC])
def test_what_is_called_anisotropic_is(name):
    """Catches a model whose direction of brushing does nothing."""
    wi, wo = direction(np.array([0.5]), np.zeros(1)), direction(np.array([0.4]), np.array([2.8]))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    model = MODELS[name]()
    assert abs(model.evaluate(wi @ turn.T, wo @ turn.T) / model.evaluate(wi, wo) - 1.0).max() > 1e-3


def test_phong_is_not_reciprocal():
    """Catches a 'repaired' Phong: the lecture's divides by the light's cosine, and by that only."""
    wi, wo = direction(np.array([1.2]), np.zeros(1)), direction(np.array([0.9]), np.array([np.pi]))
    model = MODELS["phong"](kd=0.0, ks=0.4, exponent=30.0)
    forth, back = model.evaluate(wi, wo)[0, 0], model.evaluate(wo, wi)[0, 0]
    assert forth / back == pytest.approx(np.cos(0.9) / np.cos(1.2), rel=1e-12)


def test_1982_is_exactly_four_times_the_modern_form():
    """Catches a pi or a 4 that went astray between the two normalisations."""
    wi, wo = pairs()
    values = {"kd": 0.0, "ks": 0.6, "m": 0.25, "ior": 1.6}
    old = MODELS["cook-torrance-1982"](**values).evaluate(wi, wo)
    np.testing.assert_allclose(old, 4.0 * MODELS["cook-torrance"](**values).evaluate(wi, wo), rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("lambert", {"kd": -0.1}),
        ("phong", {"exponent": -1.0}),
        ("cook-torrance", {"m": 0.0}),
        ("cook-torrance", {"ior": 0.9}),
        ("cook-torrance", {"kd": [0.1, 0.2], "ks": [0.1, 0.2, 0.3]}),
        ("lambert", {"kd": [[0.1]]}),
    ],
)
def test_parameters_without_a_meaning_are_refused(name, bad):
    """Catches a model that goes on with a negative albedo or with channels that do not match."""
    with pytest.raises(BadInput, match=name):
        MODELS[name](**bad)


def test_directions_of_a_wrong_shape_are_refused():
    """Catches angles passed where directions belong."""
    with pytest.raises(BadInput, match="wi"):
        MODELS["lambert"]().evaluate(np.zeros((5, 2)), np.zeros((5, 3)))


@pytest.mark.parametrize("coordinate", Coordinate)
def test_coordinates_are_inverses_with_the_right_slope(coordinate):
    """Catches a search coordinate whose slope would mislead the solver."""
    value = 1.7
    at = coordinate.forward(value)
    assert coordinate.inverse(at) == pytest.approx(value, rel=1e-14)
    numeric = (coordinate.inverse(at + 1e-6) - coordinate.inverse(at - 1e-6)) / 2e-6
    assert coordinate.slope(value) == pytest.approx(numeric, rel=1e-8)


@pytest.mark.parametrize("name", MODELS)
def test_parameters_describe_themselves(name):
    """Catches a default or a start outside its bounds, and a parameter that is not a field."""
    for parameter in MODELS[name].PARAMETERS:
        low, high = parameter.bounds
        assert parameter.minimum <= low <= parameter.default <= high
        assert all(low <= start <= high for start in parameter.scan)
        assert (parameter.kind is Kind.SHAPE) == bool(parameter.scan)
        assert hasattr(MODELS[name](), parameter.name)


@pytest.mark.parametrize("name", MODELS)
def test_the_page_of_models_has_it(name):
    """Catches a model that nobody can read about: `python -m benchmarks.models_page docs` writes the page."""
    docs = Path(__file__).parents[2] / "docs"
    assert f"\n### {name}\n" in (docs / "models.md").read_text("utf-8")
    assert (docs / "models" / f"{name}.png").is_file()
