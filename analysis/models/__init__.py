"""Reflectance models: each describes its own parameters, evaluates in float64, and knows its derivatives."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.models.abc import ABC
from analysis.models.anisotropic import BeckmannAnisotropic, GGXAnisotropic
from analysis.models.ashikhmin_shirley import AshikhminShirley
from analysis.models.beckmann import Beckmann, BeckmannSeparable
from analysis.models.blinn_phong import BlinnPhong
from analysis.models.cook_torrance import CookTorrance, CookTorrance1982
from analysis.models.cook_torrance_facets import CookTorranceConductor, CookTorranceGGX, CookTorranceSchlick
from analysis.models.ggx import GGX, GGXConductor, GGXDielectric, GGXSeparable
from analysis.models.lafortune import Lafortune, LafortuneRetro
from analysis.models.lambert import Lambert
from analysis.models.oren_nayar import Fujii, OrenNayar
from analysis.models.phong import ModifiedPhong, Phong
from analysis.models.sgd import SGD
from analysis.models.torrance_sparrow import (
    TorranceSparrowCosine,
    TorranceSparrowGauss,
    TorranceSparrowTrowbridgeReitz,
)
from analysis.models.two_lobes import GGXRetro, GGXTwoLobes
from analysis.models.ward import Ward, WardBounded, WardDuer

if TYPE_CHECKING:
    from analysis.models.base import Model

MODELS: dict[str, type[Model]] = {
    model.NAME: model
    for model in (
        Lambert,
        Phong,
        ModifiedPhong,
        BlinnPhong,
        Lafortune,
        LafortuneRetro,
        Ward,
        WardDuer,
        WardBounded,
        TorranceSparrowCosine,
        TorranceSparrowGauss,
        TorranceSparrowTrowbridgeReitz,
        CookTorrance1982,
        CookTorrance,
        CookTorranceSchlick,
        CookTorranceConductor,
        CookTorranceGGX,
        Beckmann,
        BeckmannSeparable,
        GGX,
        GGXSeparable,
        GGXDielectric,
        GGXConductor,
        GGXTwoLobes,
        GGXRetro,
        BeckmannAnisotropic,
        GGXAnisotropic,
        ABC,
        SGD,
        OrenNayar,
        Fujii,
        AshikhminShirley,
    )
}
"""Every model by name: `MODELS[name](**parameters).evaluate(wi, wo)`."""

DEFAULT_MODELS: tuple[str, ...] = (
    "lambert",
    "phong",
    "modified-phong",
    "blinn-phong",
    "cook-torrance-1982",
    "cook-torrance",
)
"""What is fitted when nobody says which: few enough to look at, and known to the twin."""

FITTED_MODELS: tuple[str, ...] = tuple(name for name, model in MODELS.items() if model.LAMBERT_TERM)
"""What can be fitted: Lambert's term and a lobe."""
