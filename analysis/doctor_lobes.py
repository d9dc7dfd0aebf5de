"""The best mixture of facets' lobes and diffusers: what a surface does of which only the mirror is known.

A mixture of lobes of many widths, tails and reflectances at normal incidence stands for any distribution of
facets (Torrance & Sparrow 1967), and what is left of ln f beside it says how far a reading is from such a
surface. The strengths are not negative. They minimise the weighted square sum of the difference in ln f by
steps of Gauss and Newton, each a problem of non-negative least squares (Lawson & Hanson 1974, chapter 23),
halved until the sum falls; they start from the best single lobe, than which the mixture is never worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.models import MODELS
from analysis.models.base import Geometry

if TYPE_CHECKING:
    from collections.abc import Iterator

Array = NDArray[np.float64]

LOBES_OF = (("ggx", "alpha"), ("cook-torrance-schlick", "m"))
"""Families of lobes: long tails and short ones, each with the name of its width."""
WIDTHS = (0.008, 0.015, 0.03, 0.06, 0.1, 0.17, 0.28, 0.45, 0.7)
FRESNEL = (0.04, 0.3, 1.0)
ROUGHNESS = (0.2, 0.5, 0.8)
"""Slopes of the facets of rough diffusers, radians."""
RATIOS = tuple(10.0 ** np.arange(-2.0, 3.1, 0.5))
"""Strengths of a lobe over that of the diffuser, of the single lobes that are tried."""
STEPS = 8
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
LARGEST_STEP = 1.5
"""In ln f: further than that the linear model says nothing."""
RIDGE = 1e-5
NOWHERE = 1e-100
"""Size of a lobe below which no sample sees it; its square would be no number."""
ENOUGH = 1e-3
"""Relative gain of a step below which no further one is made."""


@dataclass(frozen=True, eq=False)
class Lobes:
    """Lobes at fixed directions.

    Attributes
    ----------
    basis : ndarray, shape (N, M)
        Values of the diffusers, first Lambert's, and of the lobes, 1/sr.
    share : ndarray, shape (N,)
        Weight of each sample; the sum is 1.
    """

    basis: Array
    share: Array

    @classmethod
    def at(cls, wi: Array, wo: Array, weights: Array) -> Lobes:
        """Evaluate the lobes at directions (N, 3), samples weighing `weights` (N,)."""
        return cls(np.stack(list(_columns(wi, wo)), axis=1), weights / weights.sum())

    def single(self, log_f: Array) -> tuple[float, Array]:
        """Return the mean square of ln f about the best single lobe, and its strengths (M,)."""
        diffusers = 1 + len(ROUGHNESS)
        strengths = np.zeros(self.basis.shape[1])
        spread, scale = self._about(log_f[:, None] - np.log(self.basis[:, :diffusers]))
        column = int(np.argmin(spread))
        best, strengths[column] = float(spread[column]), np.exp(scale[column])
        for ratio in RATIOS:
            mixed = self.basis[:, :1] + ratio * self.basis[:, diffusers:]
            spread, scale = self._about(log_f[:, None] - np.log(mixed))
            column = int(np.argmin(spread))
            if spread[column] < best:
                best, strengths = float(spread[column]), np.zeros(self.basis.shape[1])
                strengths[0] = np.exp(scale[column])
                strengths[diffusers + column] = ratio * strengths[0]
        return best, strengths

    def residual(self, log_f: Array, *, mixture: bool) -> Array:
        """Return ln f (N,) less that of the best single lobe, or of the best mixture."""
        spread, strengths = self.single(log_f)
        for _ in range(STEPS if mixture else 0):
            found = self._improved(log_f, spread, strengths)
            if found is None:
                break
            gain, (spread, strengths) = spread - found[0], found
            if gain < ENOUGH * spread:
                break
        residual = log_f - np.log(self.basis @ strengths)
        return np.asarray(residual - self.share @ residual)

    def _improved(self, log_f: Array, spread: float, strengths: Array) -> tuple[float, Array] | None:
        """Return the mean square and the strengths after one step; None where none helps."""
        from scipy.optimize import nnls

        fit = self.basis @ strengths
        root = np.sqrt(self.share)
        slopes = self.basis * (root / fit)[:, None]
        wanted = root * (1.0 + np.clip(log_f - np.log(fit), -LARGEST_STEP, LARGEST_STEP))
        size = np.maximum(np.sqrt(np.square(slopes).sum(axis=0)), NOWHERE)
        slopes /= size
        factor = np.linalg.cholesky(slopes.T @ slopes + RIDGE * np.eye(len(size)))
        try:
            aim = nnls(factor.T, np.linalg.solve(factor, slopes.T @ wanted))[0] / size
        except RuntimeError:  # no end within its number of steps
            return None
        for length in STEP_LENGTHS:
            tried = strengths + length * (aim - strengths)
            about, scale = self._about(log_f - np.log(self.basis @ tried))
            if about < spread:
                return float(about), tried * np.exp(scale)
        return None

    def _about(self, residual: Array) -> tuple[Array, Array]:
        """Return the weighted mean square of residuals (N, ...) about their mean, and the mean."""
        mean = self.share @ residual
        return np.asarray(self.share @ np.square(residual - mean)), np.asarray(mean)


def _columns(wi: Array, wo: Array) -> Iterator[Array]:
    """Yield each diffuser's and each lobe's values (N,)."""
    yield np.full(len(wi), 1.0 / np.pi)
    for slope in ROUGHNESS:
        diffuser = {"kd": 1.0, "sigma_rad": slope}
        yield MODELS["oren-nayar"](**diffuser).evaluate(wi, wo)[:, 0]
    geometry = Geometry(wi, wo)
    for model, width in LOBES_OF:
        for size in WIDTHS:
            for f0 in FRESNEL:
                yield MODELS[model](**{width: size, "f0": f0}).basis_at(geometry)["ks"][:, 0]
