"""Fits of several files side by side: which parameters differ, and by more than chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.ranking import AnyFit

Array = NDArray[np.float64]

CHANCE = 0.05
"""Probability that anything at all is called different where nothing is."""


@dataclass(frozen=True, eq=False)
class Difference:
    """One parameter over F files.

    Attributes
    ----------
    parameter : str
        Parameter, or derived quantity.
    channel : int or None
        None where all channels share it.
    values, u : ndarray, shape (F,)
        Value and standard uncertainty in each file.
    mean, mean_u : float
        Weighted by 1/u^2, over the files that determine it.
    largest : float
        Largest difference of two files over its own standard uncertainty.
    p_value : float
        Probability of files that differ at least so much where all have one truth, by chi-square of the
        values about their mean; NaN where fewer than two files determine it.
    differs : bool
        Whether that is too little for chance, all parameters of the table considered (Holm 1979).
    """

    parameter: str
    channel: int | None
    values: Array
    u: Array
    mean: float
    mean_u: float
    largest: float
    p_value: float
    differs: bool = False


def differences(results: Sequence[AnyFit]) -> list[Difference]:
    """Compare fits of one model to several files.

    Their errors are taken as independent: what the files share, a white reference or a rig, makes true
    differences stand out more than the table says.

    Parameters
    ----------
    results : sequence of FitResult or FactoredFit
        Of the same model, with the same number of channels.

    Returns
    -------
    list of Difference
    """
    from dataclasses import replace

    numbers = [{n: (v, r.u[n]) for n, v in r.parameters.items()} | r.derived for r in results]
    rows = []
    for name, (first, _) in numbers[0].items():
        for channel in range(first.size) if first.ndim else (None,):
            column = [tuple(np.ravel(part)[channel or 0] for part in each[name]) for each in numbers]
            values, u = np.array(column, dtype=np.float64).T
            rows.append(_difference(name, channel, values, u))
    significant = _holm(np.array([row.p_value for row in rows]))
    return [replace(row, differs=bool(differs)) for row, differs in zip(rows, significant, strict=True)]


def _difference(name: str, channel: int | None, values: Array, u: Array) -> Difference:
    from scipy.stats import chi2

    known = np.isfinite(u) & (u > 0.0)
    weight = np.where(known, 1.0 / np.square(np.where(known, u, 1.0)), 0.0)
    total = weight.sum()
    mean = float(weight @ values / total) if total else np.nan
    apart, spread = np.abs(values[:, None] - values[None]), np.hypot(u[:, None], u[None])
    pairs = known[:, None] & known[None]
    largest = float(np.max(np.where(pairs, apart / np.where(pairs, spread, 1.0), 0.0)))
    free = int(known.sum()) - 1
    p_value = float(chi2.sf(weight @ np.square(values - mean), free)) if free > 0 else np.nan
    return Difference(
        name, channel, values, u, mean, float(1.0 / np.sqrt(total)) if total else np.inf, largest, p_value
    )


def _holm(p_values: Array) -> NDArray[np.bool_]:
    """Which of several tests reject, at `CHANCE` for all of them together."""
    reject = np.zeros(len(p_values), dtype=bool)
    tested = np.flatnonzero(np.isfinite(p_values))
    for rank, index in enumerate(tested[np.argsort(p_values[tested])]):
        if p_values[index] * (len(tested) - rank) > CHANCE:
            break
        reject[index] = True
    return reject
