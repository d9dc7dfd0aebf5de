"""The models of `analysis.models` as BSDFs of Mitsuba, written a second time in Dr.Jit's single precision.

Formulas and sources are those of `analysis.models`; so is the care against cancellation, which counts for
more in single precision. One text serves both variants: Dr.Jit's functions take Python's floats, which the
scalar variant holds, as they take its arrays. The models' own code would not do, run on Dr.Jit's arrays: it
indexes and masks NumPy's, carries derivatives that a scalar call would pay for, and guards its divisions with
numbers that single precision does not have.

A model is a row of `catalogue.LOBES`; `pair` holds what lobes need of two directions, `facets` and `fresnel`
what they are made of, and `plugin` makes a BSDF of a row. A model without a row is still evaluated in closed
form; see `has_lobes`.

Dr.Jit looks for LLVM when it is first imported: `simulator.variant` has to come before, so that nothing here
is imported at the top of a module elsewhere but this one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from simulator.mounting import Mounting

PLUGIN, PLACED = "gonio", "gonio-placed"

MOUNTINGS: dict[str, Mounting] = {}
"""By the name that a description passes: Mitsuba's properties hold no objects of ours."""

_registered: set[str] = set()


def has_lobes(model: str, channels: Iterable[Mapping[str, float]]) -> bool:
    """Whether Mitsuba can be given a model of `analysis.models`.

    Parameters
    ----------
    model : str
        Its name.
    channels : iterable of mapping of str to float
        Parameters of each channel.

    Returns
    -------
    bool
        False where the model has no row, or single precision cannot hold what the parameters make.
    """
    # Dr.Jit is not loaded by those who only read a material's line.
    from simulator.bsdfs.catalogue import LOBES

    return model in LOBES and all(LOBES[model].holds(values) for values in channels)


def register(mi: Any) -> None:
    """Make the plugins `gonio` and `gonio-placed` known to Mitsuba's current variant; again does nothing.

    Properties of `gonio` are `model` and, for each parameter and channel, `<parameter>_<channel>`.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set.
    """
    from simulator.bsdfs.placed import placed_bsdf
    from simulator.bsdfs.plugin import closed_form_bsdf

    variant = mi.variant()
    if variant not in _registered:
        mi.register_bsdf(PLUGIN, closed_form_bsdf(mi))
        mi.register_bsdf(PLACED, placed_bsdf(mi))
        _registered.add(variant)
