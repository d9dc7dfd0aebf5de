"""Numbers at the ends of what has a meaning, in every arithmetic: the thin version; all of it is slow."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from analysis.models import MODELS
from analysis.models.base import Kind
from benchmarks import light_stability_light, light_stability_precision
from benchmarks.light_stability import degenerate_pairs, extreme_pairs, extreme_parameters, values_of
from benchmarks.light_stability_light import change_far_away, three_point_change
from benchmarks.light_stability_points import (
    AT_POINTS,
    RIG,
    WIDTHS,
    exact_radiance,
    lobe,
    point_error,
    target,
)
from benchmarks.light_stability_precision import double_precision, single_precision
from benchmarks.stability_page import page
from rig.pixels import irradiance, pixel_geometry
from simulator.light.methods import METHODS

if TYPE_CHECKING:
    from collections.abc import Iterable

THIN = 10
"""Every which shape."""
QUICK = {"closed form at pixel centres", "one BSDF value per pixel", "pixel centres through Mitsuba"}
"""Methods that do not take many seconds."""


def accept(rows: Iterable[dict[str, Any]]) -> None:
    """Require all bounds to hold."""
    rows = list(rows)
    assert rows
    assert [row for row in rows if not row["ok"]] == []


class TestModels:
    @pytest.mark.parametrize("name", MODELS)
    def test_double_precision(self, name: str) -> None:
        """Would catch a cancellation, an overflow, NaN or a warning at the ends of widths and angles."""
        accept(light_stability_precision.rows_of(name, double_precision(name), THIN))

    @pytest.mark.render
    @pytest.mark.parametrize("name", MODELS)
    def test_vectorised(self, vector: Any, name: str) -> None:
        """Would catch the same in single precision, where exponents end at 1e-38 and digits at 1e-7."""
        accept(light_stability_precision.rows_of(name, single_precision(vector, name), THIN))

    @pytest.mark.render
    @pytest.mark.parametrize("name", MODELS)
    def test_scalar(self, scalar: Any, name: str) -> None:
        """Would catch a branch that only one of the variants takes."""
        accept(light_stability_precision.rows_of(name, single_precision(scalar, name), 3 * THIN))

    @pytest.mark.slow
    @pytest.mark.parametrize("name", MODELS)
    def test_all_shapes(self, name: str, vector: Any) -> None:
        """Would catch what every tenth shape misses."""
        accept(light_stability_precision.rows_of(name, double_precision(name)))
        accept(light_stability_precision.rows_of(name, single_precision(vector, name)))

    @pytest.mark.slow
    @pytest.mark.parametrize("name", MODELS)
    def test_all_shapes_one_by_one(self, name: str, scalar: Any) -> None:
        """Would catch what every thirtieth shape misses."""
        accept(light_stability_precision.rows_of(name, single_precision(scalar, name)))

    def test_every_parameter_has_ends(self) -> None:
        """Would catch a new model whose parameters are asked at their defaults only."""
        for model in MODELS.values():
            for parameter in model.PARAMETERS:
                if parameter.kind is Kind.SHAPE:
                    assert len(set(values_of(model, parameter.name))) >= 3
            assert all(model(**values) for values in extreme_parameters(model))

    def test_pairs_are_what_they_are_called(self) -> None:
        """Would catch an edge that is not looked at: grazing, opposed, equal, in the surface, below it."""
        wi, wo = extreme_pairs()
        assert np.degrees(np.arccos(min(wi[:, 2].min(), wo[:, 2].min()))) > 89.998
        assert (wi[:, 2] > 0.0).all()
        assert (wo[:, 2] > 0.0).all()
        wi, wo = degenerate_pairs()
        up = np.array([0.0, 0.0, 1.0])
        assert ((wi == -wo).all(axis=1) & (wi[:, 2] > 0.0)).any()
        assert ((wi == up) & (wo == up)).all(axis=1).any()
        assert (wi[:, 2] == 0.0).any()


@pytest.mark.render
class TestPoints:
    @pytest.mark.parametrize("evaluator", AT_POINTS, ids=lambda evaluator: evaluator.name)
    @pytest.mark.parametrize("m", WIDTHS)
    def test_pixels_are_those_of_50_digits(self, vector: Any, evaluator: Any, m: float) -> None:
        """Would catch a geometry that loses digits where lamp or camera graze, or in a narrow lobe."""
        error, pose = point_error(vector, evaluator, m)
        assert error <= target(m, single=evaluator.single), pose

    def test_50_digits_are_the_cosine_law(self) -> None:
        """Would catch a reference that is wrong together with what is held against it."""
        pose = (0.5, 0.3, -0.45, 0.2)
        material = lobe(0.3)
        white = type(material)("", "lambert", {"kd": 0.8})
        pixels = pixel_geometry(RIG, pose)
        expected = np.where(pixels.on_sample, 0.8 / np.pi * irradiance(RIG, pixels), 0.0)
        assert expected.any()
        np.testing.assert_allclose(exact_radiance(RIG, white, pose), expected, rtol=1e-13)


@pytest.mark.render
class TestMethods:
    @pytest.mark.parametrize(
        "method",
        [pytest.param(m, marks=[] if m.name in QUICK else pytest.mark.slow, id=m.name) for m in METHODS],
    )
    def test_units_poses_and_albedos(self, vector: Any, method: Any) -> None:
        """Would catch a length that is typed in, and NaN or light where none can be."""
        accept(light_stability_light.rows_of(vector, method))

    def test_far_from_the_origin(self, vector: Any) -> None:
        """Would catch a difference of large coordinates."""
        assert change_far_away(vector) <= light_stability_light.FAR_TARGET
        assert three_point_change(1.0, 1e6) <= light_stability_light.FAR_TARGET


class TestPage:
    def test_rows_find_their_places(self) -> None:
        """Would catch a model or a miss that the page leaves out."""
        common = {"unit": "relative", "target": 1e-5, "ok": True}
        rows = [
            common | {"name": "light_stability_precision: ggx, float64", "value": 1e-14},
            common | {"name": "ggx, llvm_ad_rgb", "value": 2e-4, "ok": False},
            common | {"name": "virtual lights, lengths times 1000", "value": 3e-16},
        ]
        text = page(rows)
        assert "| ggx | 1.0e-14 | 1.0e-05 | **2.0e-04** |" in text
        assert "| virtual lights, lengths times 1000 | 3.0e-16 | 1.0e-05 |" in text
        assert "2 of 3 bounds hold" in text

    def test_the_page_holds_every_model(self) -> None:
        """Would catch a page that is older than a model, or that shows a bound which does not hold."""
        text = (Path(__file__).parents[3] / "docs" / "stability.md").read_text("utf-8")
        assert all(f"\n| {name} |" in text for name in MODELS)
        assert "**" not in text
