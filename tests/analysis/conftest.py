"""Directions at which formulas break, and a comparison of models with 50 digits."""

from __future__ import annotations

from types import SimpleNamespace

import mpmath as mp
import numpy as np
import pytest

from analysis.models import MODELS
from analysis.models.base import Kind

DIGITS = 50


def _direction(theta, phi):
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) * np.ones_like(phi)], axis=-1
    )


def _hard_pairs():
    random = np.random.default_rng(11)
    theta_i, theta_o = np.radians(random.uniform(0.0, 85.0, (2, 12)))
    wi = _direction(theta_i, random.uniform(-np.pi, np.pi, 12))
    mirror = wi * np.array([-1.0, -1.0, 1.0])
    anywhere = _direction(theta_o, random.uniform(-np.pi, np.pi, 12))
    beside = mirror + 0.03 * random.standard_normal(mirror.shape)
    beside[:, 2] = np.abs(beside[:, 2])
    beside /= np.linalg.norm(beside, axis=-1, keepdims=True)
    edge_i = np.radians([0.0, 1e-7, 40.0, 89.0, 89.9, 89.999, 89.999, 89.999, 89.999, 30.0])
    edge_o = np.radians([0.0, 0.0, 40.0, 89.0, 89.99, 89.999, 89.999, 89.998, 20.0, 89.999])
    edge_phi = np.array([0.0, 0.0, 0.0, np.pi, 3.0, np.pi, 0.0, 3.14159, 2.0, 3.0])
    edges = _direction(edge_i, np.full(10, 0.3)), _direction(edge_o, 0.3 + edge_phi)
    return (
        np.concatenate([wi, wi, wi, wi[:4], edges[0]]),
        np.concatenate([anywhere, mirror, beside, wi[:4], edges[1]]),
    )


def _exact_geometry(wi, wo):
    """Return the geometry of one pair, each vector normalised in 50 digits."""

    def unit(vector):
        parts = [mp.mpf(float(x)) for x in vector]
        length = mp.sqrt(sum(x * x for x in parts))
        return [x / length for x in parts]

    light, eye = unit(wi), unit(wo)
    half = [a + b for a, b in zip(light, eye, strict=True)]
    length = mp.sqrt(sum(x * x for x in half))
    half = [x / length for x in half]
    return SimpleNamespace(
        light=light,
        eye=eye,
        half=half,
        cos_i=light[2],
        cos_o=eye[2],
        cos_h=half[2],
        cos_d=sum(a * b for a, b in zip(eye, half, strict=True)),
        sum_length=length,
    )


def _box(name):
    """Return shapes at the corners of the fit's box and inside it, evenly in search coordinates."""
    shapes = [p for p in MODELS[name].PARAMETERS if p.kind is Kind.SHAPE]
    random = np.random.default_rng(len(name))
    points = []
    for draw in range(8):
        share = random.random(len(shapes)) if draw > 3 else random.integers(0, 2, len(shapes))
        point = {}
        for p, s in zip(shapes, share, strict=True):
            low, high = (p.coordinate.forward(bound) for bound in p.bounds)
            value = p.coordinate.inverse(low + s * (high - low))
            point[p.name] = float(np.clip(value, *p.bounds))
        points.append(point)
    return points


@pytest.fixture(scope="session")
def hard_pairs():
    """Return wi, wo (N, 3): random, at and beside the mirror, back to the light, up to 89.999 deg."""
    return _hard_pairs()


def _lies_on_an_axis(geometry, values):
    """Return whether H's component along or across the axis is a difference of nearly equal numbers.

    It then has no more digits than the directions' own length, which is 1 to 16 digits only.
    """
    c, s = mp.cos(values["axis_rad"]), mp.sin(values["axis_rad"])
    x, y = geometry.half[:2]
    sideways = max(mp.hypot(v[0], v[1]) for v in (geometry.light, geometry.eye))
    return min(abs(c * x + s * y), abs(c * y - s * x)) * geometry.sum_length < 0.5 * sideways


@pytest.fixture
def agree_with_50_digits(hard_pairs):
    """Return a function that compares a model, and its derivatives, with a formula over the whole box.

    To 1e-12, derivatives to 1e-10. Near the axes of an anisotropic surface the digits that cancel in H's
    components are lost, times the ratio of the widths: there, and there alone, 1e-8 and 1e-6 have to do.
    """

    def check(name, formula, *, skip=None):
        if MODELS[name].ISOTROPIC:
            over_the_box(name, formula, tolerances=(1e-12, 1e-10), skip=skip)
        else:
            over_the_box(name, formula, tolerances=(1e-12, 1e-10), skip=_lies_on_an_axis)
            over_the_box(name, formula, tolerances=(1e-8, 1e-6), skip=None)

    def over_the_box(name, formula, **how):
        wi, wo = hard_pairs
        with mp.workdps(DIGITS):
            where = (wi, wo, [_exact_geometry(i, o) for i, o in zip(wi, wo, strict=True)])
            for shape in _box(name):
                scales = [p.name for p in MODELS[name].PARAMETERS if p.kind is not Kind.SHAPE]
                for scale in scales:
                    values = {**dict.fromkeys(scales, 0.0), scale: 0.7, **shape}
                    _compare(name, formula, values, where, **how)

    return check


def _compare(name, formula, values, where, *, tolerances, skip):
    wi, wo, geometries = where
    model = MODELS[name](**values)
    with np.errstate(all="raise"):
        ours, slopes = model.evaluate(wi, wo), model.derivatives(wi, wo)
    assert set(slopes) == set(values)
    exact_values = {key: mp.mpf(value) for key, value in values.items()}
    for row, geometry in enumerate(geometries):
        if skip is not None and skip(geometry, values):
            continue
        reference = formula(geometry, SimpleNamespace(**exact_values))
        told = f"{name} {values} {wi[row]} {wo[row]}"
        # Below the smallest normal double there are no 12 digits to have.
        error = abs(mp.mpf(float(ours[row, 0])) - reference)
        assert error <= tolerances[0] * abs(reference) + mp.mpf(1e-300), (told, error / abs(reference))
        if row % 5:
            continue
        for parameter, value in exact_values.items():
            step = mp.mpf(10) ** -16 * (value or 1)
            sides = [
                formula(geometry, SimpleNamespace(**{**exact_values, parameter: value + sign * step}))
                for sign in (1, -1)
            ]
            slope = (sides[0] - sides[1]) / (2 * step)
            error = abs(mp.mpf(float(slopes[parameter][row, 0])) - slope)
            # Where the derivative passes through zero its size is that of what cancels: f over the value.
            size = abs(slope) + mp.mpf("1e-2") * abs(reference / (value or 1))
            assert error <= tolerances[1] * size + mp.mpf(1e-290), (told, parameter, error / size)
