"""Which model: by how well it predicts incidences that it was not fitted to, and by BIC.

A model with more parameters always fits better. Cross-validation leaves out whole incidences, fits the rest,
and looks at what was left out: a lobe that has been bent to the samples is found out there. Leaving out
single samples would not do: their neighbours, which share their errors, tell nearly all of them. BIC
(Schwarz 1978) charges ln(n) for a parameter; it takes all data as independent, which favours large models
where they are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.fit import fit
from analysis.losses import ROBUST
from analysis.solver import minimise

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    import xarray as xr

    from analysis.factored_fit import FactoredFit
    from analysis.fit import FitResult
    from analysis.state import Block

Array = NDArray[np.float64]

FOLDS = 5
SAME_INCIDENCE_RAD = 0.01
CLEAR = 2.0
"""Difference of two models over its own standard error from which on it is one."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted model and what it is worth beside others.

    Attributes
    ----------
    result : FitResult or FactoredFit
        The fit to all samples.
    cross_validation : float
        Root of the mean squared residual, in the loss's own measure, of incidences left out; NaN where there
        are not two incidences.
    squares : ndarray, shape (F,)
        Mean squared residual of each fold that was left out.
    bic : float
        Bayesian information criterion; only differences mean something.
    """

    result: FitResult | FactoredFit
    cross_validation: float
    squares: Array
    bic: float

    @property
    def name(self) -> str:
        """The model's name."""
        return self.result.model.NAME


def compare(
    samples: xr.Dataset,
    names: Sequence[str],
    *,
    loss: str | None = None,
    told: Callable[[str], None] | None = None,
) -> list[Candidate]:
    """Fit models and rank them by cross-validation over incidences, or by BIC where there is but one.

    Parameters
    ----------
    samples : xarray.Dataset
        See `analysis.samples`.
    names : sequence of str
        Keys of `analysis.models.MODELS`.
    loss : str, optional
        As in `analysis.fit.fit`.
    told : callable, optional
        Called with each model's name when it is done.

    Returns
    -------
    list of Candidate
        Best first.

    Raises
    ------
    BadInput
        As `analysis.fit.fit`.
    """
    candidates = []
    for name in names:
        candidates.append(judge(fit(samples, name, loss=loss)))
        if told is not None:
            told(name)
    return ranked(candidates)


def ranked(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Sort by cross-validation, best first; by BIC where one of them could not be cross-validated."""
    candidates = list(candidates)
    known = all(np.isfinite(each.cross_validation) for each in candidates)
    return sorted(candidates, key=lambda each: each.cross_validation if known else each.bic)


def judge(result: FitResult) -> Candidate:
    """Cross-validate a fit over incidences, and compute its BIC."""
    squares, weights = _left_out(result)
    score = float(np.sqrt(np.average(squares, weights=weights))) if len(squares) else np.nan
    return Candidate(result, score, squares, bic(result))


def bic(result: FitResult) -> float:
    """Bayesian information criterion of a fit.

    chi-square + k ln n where the loss holds the uncertainties; else n ln(mean square residual) + k ln n.
    """
    return criterion(result.loss, result.state.solution.cost, result.count, len(result.names))


def criterion(loss: str, cost: float, count: int, parameters: float) -> float:
    """Compute the same from half the sum of squares, the number of data and that of parameters."""
    penalty = parameters * np.log(count)
    if loss == "chi2":
        return float(2.0 * cost + penalty)
    return float(count * np.log(max(2.0 * cost / count, 1e-300)) + penalty)


def folds_of(theta_i: Array, folds: int = FOLDS) -> NDArray[np.intp]:
    """Assign samples to folds by their incidence.

    Every incidence of a grid belongs to one fold, neighbours to different ones. Where incidences are many,
    ranges of them take their place.

    Parameters
    ----------
    theta_i : ndarray, shape (N,)
        Angle of incidence in radians.
    folds : int
        Largest number of folds.

    Returns
    -------
    ndarray of int, shape (N,)
    """
    _, level = np.unique(np.round(theta_i / SAME_INCIDENCE_RAD), return_inverse=True)
    if level.max() >= 2 * folds:
        edges = np.quantile(theta_i, np.linspace(0.0, 1.0, 2 * folds + 1)[1:-1])
        level = np.searchsorted(edges, theta_i, side="right")
    return np.asarray(level % folds, dtype=np.intp)


def _left_out(result: FitResult) -> tuple[Array, Array]:
    """Mean squared residual of each fold when the others are fitted, and the number of its data."""
    state = result.state
    wi = state.problem.geometry.wi
    fold = folds_of(np.arctan2(np.hypot(wi[:, 0], wi[:, 1]), wi[:, 2]))
    squares, weights = [], []
    numbers = np.unique(fold)
    for number in numbers if len(numbers) > 1 else []:
        kept, left = np.flatnonzero(fold != number), np.flatnonzero(fold == number)
        if not state.loss.counted[left].any() or not state.loss.counted[kept].any(axis=0).all():
            continue
        residuals = [_residuals_left(block, kept, left) for block in state.blocks]
        squares.append(mean_square(np.concatenate(residuals), result.loss))
        weights.append(sum(each.size for each in residuals))
    return np.array(squares), np.array(weights, dtype=np.float64)


def mean_square(residual: Array, loss: str) -> float:
    """Mean square of residuals left out; under the robust loss what their mean size says it is."""
    if loss == ROBUST:
        # What one model sets aside another describes: all count, and none for its square.
        return float(0.5 * np.pi * np.mean(np.abs(residual)) ** 2)
    return float(np.mean(np.square(residual)))


def _residuals_left(block: Block, kept: NDArray[np.intp], left: NDArray[np.intp]) -> Array:
    """Residuals of used data that were left out of a fit of the others."""
    # Channels first twice is channels last again.
    rest, held = block.loss.by_channel(kept).by_channel(), block.loss.reweighted(None).by_channel(left)
    found = minimise(block.problem.some(kept), rest, block.solution)
    f = block.problem.some(left).terms(found.shapes[None]).values(found.kd[None], found.ks[None])[0]
    return np.asarray(held.residual(f)[held.used])


def in_words(candidates: Sequence[Candidate]) -> str:
    """Say in one sentence what the best model gains over the next, and whether that is clear.

    Parameters
    ----------
    candidates : sequence of Candidate
        Ranked, of the same samples and loss.

    Returns
    -------
    str
        Empty for fewer than two.
    """
    if len(candidates) < 2:
        return ""
    first, second = candidates[:2]
    if not np.isfinite(first.cross_validation):
        gap = second.bic - first.bic
        return (
            f"one incidence cannot be cross-validated; by BIC {first.name} is ahead of {second.name} by "
            f"{gap:.3g} ({'clearly' if gap > 10.0 else 'hardly'})"
        )
    gain = 100.0 * (1.0 - first.cross_validation / second.cross_validation)
    said = (
        f"on incidences it has not seen {first.name} errs by {first.cross_validation:.3g}, "
        f"{gain:.2g} % less than {second.name}"
    )
    if _clear(second.squares - first.squares):
        return said
    return f"{said}: no more than chance, so take the one with fewer parameters or a known meaning"


def _clear(differences: Array) -> bool:
    """Whether the mean of folds' differences exceeds what their scatter allows."""
    if len(differences) < 2:
        return False
    error = np.std(differences, ddof=1) / np.sqrt(len(differences))
    return bool(np.mean(differences) > CLEAR * error)
