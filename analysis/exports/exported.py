"""What an export says of itself, and the directions at which it is compared with the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.angles import from_half_difference

Array = NDArray[np.float64]

LOWEST_COSINE = float(np.cos(np.radians(80.0)))


class Reflects(Protocol):
    """Anything with a BRDF."""

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """Return f_r (N, C) in 1/sr."""


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes
    ----------
    form : str
        What it is, for people.
    files : tuple of str
        Names of the files.
    median_relative, p95_relative : float
        Median and 95th percentile of |export - model| / model up to 80 deg, over half and difference angles.
    delta_e : float
        Mean CIEDE2000 of a shaded sphere; 0 where the form is exact.
    """

    form: str
    files: tuple[str, ...]
    median_relative: float
    p95_relative: float
    delta_e: float

    def __str__(self) -> str:
        return (
            f"{', '.join(self.files)}: {self.form}; {100.0 * self.median_relative:.2g} % from the fit "
            f"(median), {100.0 * self.p95_relative:.2g} % (95th percentile), "
            f"Delta E of a sphere {self.delta_e:.2g}"
        )


def compared_directions(*, isotropic: bool = True) -> tuple[Array, Array]:
    """Return pairs of directions, dense at the peak: a grid of half and difference angles up to 80 deg.

    For anisotropic surfaces the half vectors lie at azimuths of half a turn.
    """
    theta_h = np.radians(85.0) * np.linspace(0.0, 1.0, 30) ** 2
    theta_d, phi_d = np.radians(np.arange(0.0, 80.0, 8.0)), np.radians(np.arange(0.0, 181.0, 22.5))
    phi_h = np.zeros(1) if isotropic else np.radians(np.arange(0.0, 180.0, 22.5))
    grid = np.meshgrid(theta_h, theta_d, phi_d, phi_h, indexing="ij")
    wi, wo = (w.reshape(-1, 3) for w in from_half_difference(grid[0], grid[3], grid[1], grid[2]))
    above = (wi[:, 2] >= LOWEST_COSINE) & (wo[:, 2] >= LOWEST_COSINE)
    return wi[above], wo[above]


def relative(given: Array, true: Array) -> tuple[float, float]:
    """Median and 95th percentile of the relative difference, where the model is above zero."""
    lit = true > 0.0
    error = np.abs(given - true)[lit] / true[lit]
    if not error.size:
        return 0.0, 0.0
    return float(np.median(error)), float(np.percentile(error, 95.0))
