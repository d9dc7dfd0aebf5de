"""What a fit uses of samples: which data, how uncertain they are, and whether they suffice for a model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import uncertainty
from analysis.models.base import Geometry, Kind
from analysis.plausibility import require_unit_vectors
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

    from analysis.models.base import Model

Array = NDArray[np.float64]

SAME_DIRECTION = 1e-9
"""Difference of components below which two directions are one."""


@dataclass(frozen=True)
class Observations:
    """The rows of samples that some channel uses.

    Attributes
    ----------
    samples : xarray.Dataset
        These rows alone.
    wi, wo : ndarray, shape (N, 3)
        Unit directions.
    f_r : ndarray, shape (N, C)
        In 1/sr; anything where unused.
    used : ndarray of bool, shape (N, C)
        Which data count.
    stated : bool
        Whether the samples say how uncertain they are.
    """

    samples: xr.Dataset
    wi: Array
    wo: Array
    f_r: Array
    used: NDArray[np.bool_]
    stated: bool

    @property
    def cos_i(self) -> Array:
        """Cosine of incidence, shape (N, 1)."""
        return self.wi[:, 2:]

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels."""
        return tuple(str(name) for name in self.samples["channel"].to_numpy())

    def total(self, poses: list[uncertainty.SharedError]) -> Array | None:
        """Return each datum's uncertainty (N, C) for the weights: all but the errors that all data share.

        `poses` are the errors of the joints; None where the samples state no uncertainty.
        """
        if not self.stated:
            return None
        shared = [e.column for e in uncertainty.shared_in_f(self.samples) if e.name not in uncertainty.COMMON]
        columns = [uncertainty.independent(self.samples), *shared, *(e.column for e in poses)]
        return uncertainty.quadrature(*columns) + np.zeros_like(self.f_r)


def observe(samples: xr.Dataset) -> Observations:
    """Take what can be used: data with a value, without a flag, lit and seen, with an uncertainty if any has.

    Parameters
    ----------
    samples : xarray.Dataset
        See `analysis.samples`.

    Returns
    -------
    Observations
    """
    wi, wo = samples["wi"].to_numpy(), samples["wo"].to_numpy()
    f_r = np.asarray(samples["f_r"].to_numpy(), dtype=np.float64)
    require_unit_vectors(wi, wo)
    geometry = Geometry(wi, wo)
    used = np.isfinite(f_r) & geometry.visible[:, None]
    if "flags" in samples:
        used &= samples["flags"].to_numpy() == 0
    stated = uncertainty.has_uncertainty(samples)
    if stated:
        for column in (
            uncertainty.independent(samples),
            *(e.column for e in uncertainty.shared_in_f(samples)),
        ):
            used &= np.isfinite(column)
    # Rows that no channel uses carry nothing but time.
    rows = used.any(axis=1)
    if not rows.all():
        samples, wi, wo, f_r, used = samples.isel(sample=rows), wi[rows], wo[rows], f_r[rows], used[rows]
    return Observations(samples, wi, wo, f_r, used, stated)


def check_enough(data: Observations, model: type[Model], *, shared: bool = True) -> None:
    """Refuse what no model, or not this one, can be fitted to; `shared` is whether channels share shapes.

    Raises
    ------
    BadInput
        If a channel has no usable datum, all are zero, or pairs of directions are fewer than parameters.
    """
    name = model.NAME
    if not data.used.any():
        raise BadInput(
            "no usable sample: all are flagged, without a value, or below the horizon",
            where=name,
            todo="see flags",
        )
    empty = np.flatnonzero(~data.used.any(axis=0))
    if empty.size:
        channel = data.channels[empty[0]]
        raise BadInput(
            f"channel {channel} has no usable sample",
            where=name,
            todo="leave the channel out, or give it values, and uncertainties where others have them",
        )
    if not np.any(data.f_r[data.used]):
        raise BadInput("every f_r is zero", where=name, todo="check the reduction and the channel")
    needed = len(model.PARAMETERS)
    directions = _different_pairs(data.wi, data.wo, needed)
    if directions < needed:
        raise BadInput(
            f"{directions} different pairs of directions for {needed} parameters",
            where=name,
            todo=f"measure at least {needed} pairs, or fit a model with fewer parameters",
        )
    scales = sum(p.kind is not Kind.SHAPE for p in model.PARAMETERS)
    each = scales if shared else needed
    for channel, rows in zip(data.channels, data.used.T, strict=True):
        found = directions if rows.all() else _different_pairs(data.wi[rows], data.wo[rows], each)
        if found < each:
            raise BadInput(
                f"channel {channel} has {found} different pairs of directions for {each} parameters",
                where=name,
                todo=f"measure at least {each} pairs in it, or leave the channel out",
            )


def _different_pairs(wi: Array, wo: Array, most: int) -> int:
    """Count the different pairs of directions, as far as `most`."""
    # The first hundred samples nearly always tell.
    for count in (100, len(wi)):
        rest, found = np.hstack([wi[:count], wo[:count]]), 0
        while len(rest) and found < most:
            rest = rest[np.max(np.abs(rest - rest[0]), axis=1) > SAME_DIRECTION]
            found += 1
        if found == most:
            break
    return found
