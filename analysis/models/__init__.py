"""Reflectance models: each describes its own parameters, evaluates in float64, and knows its derivatives."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.models.blinn_phong import BlinnPhong
from analysis.models.cook_torrance import CookTorrance, CookTorrance1982
from analysis.models.lambert import Lambert
from analysis.models.phong import ModifiedPhong, Phong

if TYPE_CHECKING:
    from analysis.models.base import Model

MODELS: dict[str, type[Model]] = {
    model.NAME: model for model in (Lambert, Phong, ModifiedPhong, BlinnPhong, CookTorrance1982, CookTorrance)
}
"""Every model by name: `MODELS[name](**parameters).evaluate(wi, wo)`."""
