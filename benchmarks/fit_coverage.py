"""How often the fits' 95 % intervals hold the truth: drawn data of known surfaces, cell by cell.

A GGX surface over Lambert is measured at 400 pairs of directions, a third anywhere, two thirds around the
mirror direction, with 1 and 5 % noise, for widths of the lobe from 0.05 to 0.6. The intervals are value plus
or minus 1.96 u. Draws whose fit says that something is not determined are counted apart, as a reader of the
caution would; data set aside, and kd and ks that trade under a wide lobe, leave u standing and count.

The same surfaces, and some with the lobe of Cook-Torrance, then state no uncertainty, with noise in
proportion to the value or constant, and are fitted under every loss that can do without. These cells have
fewer draws; widths and parameters are pooled, and the least of the single coverages is given beside.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.fit import fit
from analysis.identifiability import Kind
from analysis.models import MODELS
from analysis.samples import make_samples
from benchmarks.rows import row
from gonio.output import Progress
from rig.angles import spherical_to_direction

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from analysis.fit import FitResult

NOISES = (0.01, 0.05)
ALPHAS = (0.05, 0.1, 0.2, 0.4, 0.6)
DRAWS = 2000
PAIRS = 400
QUANTILE = 1.959964
LOW, HIGH, MOST_BIAS = 0.93, 0.97, 0.005
UNSTATED_DRAWS, UNSTATED_ALPHAS = 150, (0.05, 0.1, 0.2, 0.4)
UNSTATED_MODELS = {"ggx": "alpha", "cook-torrance-schlick": "m"}
UNSTATED_LOSSES = ("l2", "log", "cbrt", "robust")
UNSTATED_NOISES = {"in proportion, 5 %": (0.05, 0.0), "constant": (0.0, 0.05)}
"""Noise as shares of the value and of the median value."""
STANDING = {Kind.OUTLIERS, Kind.KD_KS}
"""Cautions beside which u is what it says."""
MOST_WARNED = 0.2
"""Share of draws with a warning from which on a cell is listed apart."""


class Cell(NamedTuple):
    """What came of one noise and width.

    Attributes
    ----------
    coverage : dict of str to float
        Share of intervals that hold the truth, by parameter, over draws without a warning.
    bias : float
        Mean of alpha over the truth, minus 1.
    warned : float
        Share of draws with a warning.
    """

    coverage: dict[str, float]
    bias: float
    warned: float


def directions(alpha: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions that suit a lobe: spread around the mirror direction by a few times its width."""
    random = np.random.default_rng(1)
    theta_i = np.radians(random.uniform(3.0, 78.0, PAIRS))
    spread = np.where(np.arange(PAIRS) % 3 == 0, 0.6, 2.0 * alpha)
    theta_o = np.clip(np.abs(theta_i + spread * random.standard_normal(PAIRS)), 0.0, np.radians(82.0))
    phi = 2.0 * spread * random.standard_normal(PAIRS)
    return spherical_to_direction(theta_i, np.full(PAIRS, np.pi)), spherical_to_direction(theta_o, phi)


def study(noise: float, alpha: float, draws: int = DRAWS) -> Cell:
    """Draw data of GGX that state their uncertainty, and fit."""
    truth = {"kd": 0.2, "ks": 0.9, "alpha": alpha, "f0": 0.05}
    wi, wo = directions(alpha)
    exact = MODELS["ggx"](**truth).evaluate(wi, wo)
    random = np.random.default_rng(round(1e6 * noise + 1e4 * alpha))

    def draw() -> FitResult:
        f_r = exact * (1.0 + noise * random.standard_normal(exact.shape))
        return fit(make_samples(wi, wo, f_r, u_noise=noise * exact), "ggx")

    return _count(draw, truth, alpha, draws)


def study_unstated(
    name: str, loss: str, noise: tuple[float, float], alpha: float, draws: int = UNSTATED_DRAWS
) -> Cell:
    """Draw data that state no uncertainty, and fit."""
    truth = {"kd": 0.2, "ks": 0.9, UNSTATED_MODELS[name]: alpha, "f0": 0.05}
    wi, wo = directions(alpha)
    exact = MODELS[name](**truth).evaluate(wi, wo)
    size = noise[0] * exact + noise[1] * np.median(exact)
    random = np.random.default_rng(round(1e6 * noise[0] + 1e4 * alpha))

    def draw() -> FitResult:
        return fit(make_samples(wi, wo, exact + size * random.standard_normal(exact.shape)), name, loss=loss)

    return _count(draw, truth, alpha, draws)


def _count(draw: Callable[[], FitResult], truth: dict[str, float], alpha: float, draws: int) -> Cell:
    """Count how often intervals hold the truth; the third parameter is the width."""
    held: dict[str, list[bool]] = {name: [] for name in truth}
    alphas, warned = [], 0
    for _ in range(draws):
        result = draw()
        if any(caution.kind not in STANDING for caution in result.cautions):
            warned += 1
            continue
        alphas.append(float(result.parameters[list(truth)[2]]))
        for name, value in truth.items():
            off = abs(result.parameters[name].item() - value)
            held[name].append(off <= QUANTILE * result.u[name].item())
    coverage = {name: float(np.mean(each)) if each else np.nan for name, each in held.items()}
    bias = float(np.mean(alphas)) / alpha - 1.0 if alphas else np.nan
    return Cell(coverage, bias, warned / draws)


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Study every cell; see the module."""
    del plots
    rows = []
    groups = list(itertools.product(UNSTATED_MODELS, UNSTATED_LOSSES, UNSTATED_NOISES))
    progress = Progress("cells", len(NOISES) * len(ALPHAS) + len(groups))
    for noise in NOISES:
        for alpha in ALPHAS:
            rows += _rows(f"{100 * noise:.0f} % noise, alpha {alpha:g}", study(noise, alpha))
            progress()
    for name, loss, kind in groups:
        cells = [study_unstated(name, loss, UNSTATED_NOISES[kind], alpha) for alpha in UNSTATED_ALPHAS]
        rows += _pooled(f"no uncertainty stated, {name}, loss {loss}, noise {kind}", cells)
        progress()
    return rows


def _pooled(label: str, cells: list[Cell]) -> list[dict[str, Any]]:
    single = [value for cell in cells if cell.warned <= MOST_WARNED for value in cell.coverage.values()]
    mean, least = (float(np.mean(single)), min(single)) if single else (np.nan, np.nan)
    apart = sum(cell.warned > MOST_WARNED for cell in cells)
    return [
        row(f"{label}: coverage", mean, "", LOW, at_least=True),
        row(f"{label}: coverage, from above", mean, "", HIGH),
        row(f"{label}: least of a width and parameter", least, ""),
        row(f"{label}: widths with a caution, not counted", float(apart), f"of {len(cells)}"),
    ]


def _rows(label: str, cell: Cell) -> list[dict[str, Any]]:
    apart = cell.warned > MOST_WARNED
    low, high, bias = min(cell.coverage.values()), max(cell.coverage.values()), 100.0 * abs(cell.bias)
    return [
        row(f"{label}: least coverage", low, "", None if apart else LOW, at_least=True),
        row(f"{label}: largest coverage", high, "", None if apart else HIGH),
        row(f"{label}: bias of alpha", bias, "%", None if apart else 100.0 * MOST_BIAS),
        row(f"{label}: draws with a caution, not counted", 100.0 * cell.warned, "%"),
    ]
