"""What a written file does not give back of the samples that it was made from: one type for all formats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical

if TYPE_CHECKING:
    from collections.abc import Collection

    import xarray as xr

Array = NDArray[np.float64]
Evaluate = Callable[[Array, Array], Array]

PEAK_FRACTION = 0.5
"""Samples above this part of their channel's largest value are the peak."""

NOTHING = 1e-3
"""A value below this part of the channel's median has no relative error worth a name: it is compared with
this part."""

CARRIED = ("wi", "wo", "f_r")
"""What every format holds."""


@dataclass(frozen=True)
class Loss:
    """Relative errors of a file at the samples that it was made from, and what it leaves out.

    Attributes
    ----------
    samples : int
        Samples written.
    median_relative, p95_relative : float
        Median and 95th percentile of |file - sample| / |sample|, off the peak.
    worst_relative : float
        The largest, at the peak too.
    where_worst : str
        Its directions and channel; empty where nothing changed.
    u_between_relative : float
        Between samples: median of the interpolation's standard uncertainty over f_r, where a grid was filled
        by one that knows it; 0 elsewhere.
    cells : int
        Values of the format's grid above the surface; 0 where samples are written as they are.
    filled : int
        Those of them that have no sample nearby: the format wants a number, and got one that is a guess.
    dropped : tuple of str
        What the format does not hold, one phrase each.
    """

    samples: int
    median_relative: float = 0.0
    p95_relative: float = 0.0
    worst_relative: float = 0.0
    where_worst: str = ""
    u_between_relative: float = 0.0
    cells: int = 0
    filled: int = 0
    dropped: tuple[str, ...] = ()

    @property
    def filled_part(self) -> float:
        """Part of the grid that has no sample nearby, 0 to 1."""
        return self.filled / self.cells if self.cells else 0.0

    def __str__(self) -> str:
        parts = []
        if self.worst_relative > 0.0:
            parts.append(
                f"off the peak {100.0 * self.median_relative:.2g} % (median), "
                f"{100.0 * self.p95_relative:.2g} % (95th percentile), "
                f"at most {100.0 * self.worst_relative:.2g} % at {self.where_worst}"
            )
        else:
            parts.append("the samples' values are kept")
        if self.u_between_relative:
            parts.append(f"between samples {100.0 * self.u_between_relative:.2g} % (standard uncertainty)")
        if self.filled:
            parts.append(f"{100.0 * self.filled_part:.2g} % of the grid has no sample nearby")
        if self.dropped:
            parts.append(f"left out: {', '.join(self.dropped)}")
        return "; ".join(parts)


def unchanged(samples: xr.Dataset, written: int, kept: Collection[str] = ()) -> Loss:
    """Return the loss of a format that holds the samples' values as they are.

    Parameters
    ----------
    samples : xarray.Dataset
        What was to be written.
    written : int
        How many samples were.
    kept : collection of str
        Variables that the format holds beside directions and f_r; see `dropped`.
    """
    return Loss(written, dropped=dropped(samples, written, kept))


def compared(
    samples: xr.Dataset,
    wi: Array,
    wo: Array,
    f_r: Array,
    back: Array,
    *,
    cells: int = 0,
    filled: int = 0,
    kept: Collection[str] = (),
) -> Loss:
    """Compare what a file gives back with the samples that went into it.

    Parameters
    ----------
    samples : xarray.Dataset
        What was to be written.
    wi, wo : ndarray, shape (N, 3)
        Directions of those that were.
    f_r, back : ndarray, shape (N, C)
        Their values, and those of the file in the same directions.
    cells, filled : int
        As in `Loss`.
    kept : collection of str
        As in `dropped`.
    """
    size = np.abs(f_r)
    scale = np.maximum(size, NOTHING * np.median(size, axis=0) + np.finfo(float).tiny)
    error = np.abs(back - f_r) / scale
    peak = size > PEAK_FRACTION * size.max(axis=0)
    off = error[~peak] if (~peak).any() else error.ravel()
    row, channel = np.unravel_index(np.argmax(error), error.shape)
    name = str(samples["channel"].to_numpy()[min(int(channel), samples.sizes["channel"] - 1)])
    return Loss(
        samples=len(f_r),
        median_relative=float(np.median(off)),
        p95_relative=float(np.percentile(off, 95.0)),
        worst_relative=float(error[row, channel]),
        where_worst=f"{place_of(wi[row], wo[row])}, channel {name}",
        cells=cells,
        filled=filled,
        dropped=dropped(samples, len(f_r), kept),
    )


def place_of(wi: Array, wo: Array) -> str:
    """Name one pair of directions for people."""
    angles = [float(np.degrees(angle)) for w in (wi, wo) for angle in direction_to_spherical(w)]
    names = ("theta_i", "phi_i", "theta_o", "phi_o")
    return " ".join(f"{name} {angle:.1f}" for name, angle in zip(names, angles, strict=True)) + " deg"


def dropped(samples: xr.Dataset, written: int, kept: Collection[str] = ()) -> tuple[str, ...]:
    """Name what a format leaves out of samples.

    Parameters
    ----------
    samples : xarray.Dataset
        What was to be written.
    written : int
        How many samples were.
    kept : collection of str
        What the format holds beside directions and f_r: variables, `wavelength_nm`, and attributes.

    Returns
    -------
    tuple of str
        Samples left out, then variables, coordinates and attributes by name.
    """
    left_out = samples.sizes["sample"] - written
    names = [f"{left_out} samples that are flagged or without a value"] if left_out > 0 else []
    held = {*CARRIED, *kept}
    variables = [str(name) for name in samples.data_vars if name not in held]
    # Flags tell why samples were left out: where there are none, nothing is lost with them.
    names += [name for name in variables if name != "flags" or bool((samples["flags"] != 0).any())]
    names += [str(name) for name in samples.coords if name not in {"channel", "xyz", *held}]
    names += [str(name) for name, value in samples.attrs.items() if name not in held and _says(name, value)]
    return tuple(names)


def _says(name: object, value: Any) -> bool:
    """Whether an attribute tells more than gonio's own conventions do."""
    if name in {"conventions", "cosine", "source"}:
        return False
    return not (isinstance(value, float) and np.isnan(value))
