"""Readings weighed: evidence, the share of samples above the horizon, and how many steps it takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.doctor_evidence import LENGTHS, Directions, Evidence
from analysis.pairing import FEWEST_PAIRS, reciprocal_difference

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.angle_table import AngleTable
    from analysis.doctor_readings import Reading, Step

Array = NDArray[np.float64]

INDEPENDENT = 40.0
"""Samples that the process counts as independent, at most: neighbours share what no model describes."""
LOBE_INDEPENDENT = 100.0
"""Samples that the misfit of the lobes counts as independent."""
FEWEST = 20
MOST_IMPOSSIBLE, ALLOWED_IMPOSSIBLE, PER_IMPOSSIBLE = 0.3, 0.02, 600.0
"""Share of samples below the horizon that rules out a reading, that is free, and the cost of the rest."""
NARROW, NARROW_COST = float(np.radians(3.0)), 25.0
"""Nobody measures within this angle of the normal only."""
COMPARED = float(np.radians(82.0))
GRAZING = float(np.radians(72.0))
"""Footprints and stray light rule beyond it: a decision has to stand without."""
NEAR = float(np.radians(50.0))
"""Within it a lobe has to tell a factor cos(theta_i) cos(theta_o), which reciprocity does not."""
FAVOUR = (2.0, 0.0, -4.0)
"""Logarithm of the prior odds by the number of steps: files are mostly what they say."""


@dataclass(frozen=True)
class Ranked:
    """A reading, or several that give the same samples.

    Attributes
    ----------
    reading : Reading
        The simplest of them.
    same : tuple of Reading
        The others that give exactly the same samples.
    log_odds : float
        Natural logarithm of its odds against the best.
    log_odds_steep, log_odds_near : float
        The same without the grazing samples, and near the normal only; -inf where too few are left.
    above_horizon : float
        Share of the samples with both directions above the horizon.
    reciprocity : float
        Median relative difference of reciprocal pairs; NaN where there are too few.
    evidence : Evidence
        What speaks for it.
    alike : tuple of Reading
        More of them, that give the same f_r in the same directions within noise.
    """

    reading: Reading
    same: tuple[Reading, ...]
    log_odds: float
    log_odds_steep: float
    log_odds_near: float
    above_horizon: float
    reciprocity: float
    evidence: Evidence
    alike: tuple[Reading, ...] = ()

    @property
    def group(self) -> tuple[Reading, ...]:
        """All readings that it stands for."""
        return (self.reading, *self.same, *self.alike)


class Weighing:
    """Weighs readings of the same samples; what readings at the same directions share is found once.

    Parameters
    ----------
    table : AngleTable
        Samples as declared, one channel, all positive.
    weights : ndarray, shape (N,)
    quick : bool
        For the first sight: single lobes, one length, all angles.
    """

    def __init__(self, table: AngleTable, weights: Array, *, quick: bool) -> None:
        self._table, self._weights, self._quick = table, weights, quick
        self._lengths = LENGTHS[1:2] if quick else LENGTHS
        self._known: dict[tuple[tuple[Step, ...], float], Directions] = {}

    def ranked(self, groups: Sequence[Sequence[Reading]]) -> list[Ranked]:
        """Return the readings, best first, without those that are impossible."""
        found = (self._weighed(same) for same in groups)
        return sorted((each for each in found if each is not None), key=lambda each: -each.log_odds)

    def _weighed(self, same: Sequence[Reading]) -> Ranked | None:
        read = same[0].apply(self._table)
        possible = read.possible()
        share = float(possible.mean()) if possible.size else 0.0
        largest = np.maximum(np.abs(read.theta_i), np.abs(read.theta_o))
        use = possible & (largest < COMPARED)
        if share < 1.0 - MOST_IMPOSSIBLE or np.count_nonzero(use) < FEWEST:
            return None
        prior = FAVOUR[len(same[0].steps)]
        prior -= PER_IMPOSSIBLE * max(1.0 - share - ALLOWED_IMPOSSIBLE, 0.0)
        prior -= NARROW_COST if largest[use].max() < NARROW else 0.0
        found, log = self._evidence(same[0], read, use, COMPARED)
        parts = {GRAZING: -np.inf, NEAR: -np.inf}
        for within in () if self._quick else tuple(parts):
            if np.count_nonzero(use & (largest < within)) >= FEWEST:
                parts[within] = prior + self._evidence(same[0], read, use & (largest < within), within)[1]
        reciprocity = float("nan") if self._quick else _reciprocity(read.rows(use))
        steep, near = parts.values()
        total = prior + log
        return Ranked(same[0], tuple(same[1:]), total, steep, near, share, reciprocity, found)

    def _evidence(
        self, reading: Reading, read: AngleTable, use: NDArray[np.bool_], within: float
    ) -> tuple[Evidence, float]:
        """Return the evidence of some samples, and its logarithm of the likelihood."""
        turned = reading.turned
        if (turned, within) not in self._known:
            rows = read.rows(use)
            self._known[turned, within] = Directions(rows.wi, rows.wo, self._weights[use], self._lengths)
        found = self._known[turned, within].evidence(read.f_r[use, 0], mixture=not self._quick)
        independent = min(INDEPENDENT, float(len(self._weights)))
        log = independent * found.total - LOBE_INDEPENDENT * found.lobe_misfit
        return found, log + found.asymmetry.log_likelihood


def _reciprocity(table: AngleTable) -> float:
    difference = reciprocal_difference(table.wi, table.wo, table.f_r)
    return float(np.median(difference)) if len(difference) >= FEWEST_PAIRS else float("nan")
