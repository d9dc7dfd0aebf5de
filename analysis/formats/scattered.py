"""From scattered samples to the grid of a format: which samples can be used, and what lies between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.interpolation import Interpolant
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

FEWEST_SAMPLES = 16


class Usable(NamedTuple):
    """Samples that can be exported: directions (N, 3) above the surface, finite f_r (N, C), and its u."""

    wi: Array
    wo: Array
    f_r: Array
    u_independent: Array
    u_common: Array


def usable(samples: xr.Dataset) -> Usable:
    """Choose the samples without flags whose directions and values are whole.

    Raises
    ------
    BadInput
        If fewer than 16 remain.
    """
    wi, wo, f_r = (samples[name].to_numpy() for name in ("wi", "wo", "f_r"))
    flags = samples["flags"].to_numpy() if "flags" in samples else np.zeros(f_r.shape, dtype=int)
    good = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0) & np.isfinite(f_r).all(-1) & (flags == 0).all(-1)
    if good.sum() < FEWEST_SAMPLES:
        raise BadInput(
            f"only {good.sum()} samples can be used, {FEWEST_SAMPLES} are needed",
            where="samples",
            todo="measure more directions, or write a table of samples",
        )
    independent, common = _uncertainty(samples)
    return Usable(wi[good], wo[good], f_r[good], independent[good], common[good])


def interpolant_of(given: Usable) -> Interpolant:
    """Interpolate between usable samples; see `analysis.interpolation.Interpolant`."""
    wi, wo, f_r, independent, common = given
    return Interpolant(wi, wo, f_r, u_independent=independent, u_common=common)


def _uncertainty(samples: xr.Dataset) -> tuple[Array, Array]:
    """Return the part of u_f_r that is each sample's own, and the rest, which is taken as common to all.

    Where nothing tells them apart, all is each sample's own.
    """
    zero = np.zeros(samples["f_r"].shape)
    if "u_f_r" not in samples:
        return zero, zero
    total = np.nan_to_num(samples["u_f_r"].to_numpy(), nan=0.0, posinf=0.0)
    names = [name for name in ("u_noise", "u_binning") if name in samples]
    if not names:
        return total, zero
    own = np.sqrt(sum(np.square(np.nan_to_num(samples[name].to_numpy())) for name in names))
    return own, np.sqrt(np.maximum(np.square(total) - np.square(own), 0.0))
