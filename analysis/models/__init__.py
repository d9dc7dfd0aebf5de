"""Reflectance models: each describes its own parameters, evaluates in float64, and knows its derivatives.

A new model is one file in this folder: `discover` finds every class in it that has a NAME.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module
from typing import TYPE_CHECKING

from analysis.models.base import Model

if TYPE_CHECKING:
    from collections.abc import Iterable


def discover(folders: Iterable[str]) -> dict[str, type[Model]]:
    """Import the modules of this package that lie in some folders, and collect the models they define.

    Parameters
    ----------
    folders : iterable of str
        Folders on this package's `__path__`.

    Returns
    -------
    dict of str to type of Model
        By name, in alphabetical order.

    Raises
    ------
    ValueError
        If two classes have the same name: a mistake of whoever wrote the second.
    """
    found: dict[str, type[Model]] = {}
    for module in pkgutil.iter_modules(folders, prefix=f"{__name__}."):
        for value in vars(import_module(module.name)).values():
            if not isinstance(value, type) or not issubclass(value, Model):
                continue
            if value.__module__ != module.name or not hasattr(value, "NAME"):
                continue
            if value.NAME in found:
                raise ValueError(f"{value} and {found[value.NAME]} are both called {value.NAME}")
            found[value.NAME] = value
    return dict(sorted(found.items()))


MODELS: dict[str, type[Model]] = discover(__path__)
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

FITTED_MODELS: tuple[str, ...] = tuple(MODELS)
"""What can be fitted: all that is linear in kd and ks."""
