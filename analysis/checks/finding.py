"""What a check says: a number, its thresholds, a verdict, what it may mean and where to look."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from analysis.pairing import FEWEST_PAIRS, Array, Indices, Usable, relative_difference


class Verdict(Enum):
    """What a check says; in order of gravity."""

    PASS = "pass"  # noqa: S105 - a verdict, no password
    NOT_TESTED = "not tested"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, eq=False)
class Finding:
    """One check's outcome.

    Attributes
    ----------
    name, quantity : str
        The check, and what its number is.
    value : float
        The number; NaN where not tested.
    warn, fail : float
        The verdict is worse where the number exceeds these.
    count : int
        Pairs or samples behind the number.
    verdict : Verdict
        The outcome.
    meaning, where : str
        What it may mean, and where to look.
    samples : ndarray of int
        Numbers in the file of the samples that the check objects to; a person may reject them.
    """

    name: str
    quantity: str
    value: float
    warn: float
    fail: float
    count: int
    verdict: Verdict
    meaning: str = ""
    where: str = ""
    samples: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))


def judged(
    name: str,
    quantity: str,
    value: float,
    limits: tuple[float, float],
    count: int,
    *,
    meaning: str,
    where: str,
    samples: Indices | None = None,
) -> Finding:
    """Compare a number with its thresholds; the meaning is told only where it exceeds one."""
    warn, fail = limits
    verdict = Verdict.FAIL if value > fail else Verdict.WARN if value > warn else Verdict.PASS
    told = ("", "") if verdict is Verdict.PASS else (meaning, where)
    objected = np.zeros(0, dtype=np.intp) if samples is None else np.unique(samples)
    return Finding(name, quantity, value, warn, fail, count, verdict, *told, samples=objected)


def not_tested(name: str, quantity: str, limits: tuple[float, float], count: int, why: str) -> Finding:
    """Say why a check could not be made."""
    return Finding(name, quantity, float("nan"), *limits, count, Verdict.NOT_TESTED, why)


def median_by_channel(difference: Array) -> float:
    """Return the median over pairs and channels; NaN for none."""
    return float(np.median(difference)) if difference.size else float("nan")


def place(usable: Usable, index: np.intp | int) -> str:
    """Name a sample's geometry for people."""
    theta_i, theta_o, turn = (np.degrees(x[index]) for x in (usable.theta_i, usable.theta_o, usable.turn))
    return f"theta_i {theta_i:.1f}, theta_o {theta_o:.1f}, azimuth between them {turn:.1f} deg"


def compared(
    name: str,
    quantity: str,
    limits: tuple[float, float],
    usable: Usable,
    pairs: tuple[Indices, Indices],
    *,
    meaning: str,
    why_not: str,
) -> Finding:
    """Judge the median relative difference of pairs; `why_not` where there are too few."""
    first, second = pairs
    if len(first) < FEWEST_PAIRS:
        return not_tested(name, quantity, limits, len(first), why_not)
    difference = relative_difference(usable.f_r[first], usable.f_r[second])
    spot = place(usable, first[int(np.argmax(np.median(difference, axis=1)))])
    return judged(
        name,
        quantity,
        median_by_channel(difference),
        limits,
        len(first),
        meaning=meaning,
        where=spot,
        samples=far_apart(usable, pairs, difference, limits),
    )


def far_apart(
    usable: Usable, pairs: tuple[Indices, Indices], difference: Array, limits: tuple[float, float]
) -> Indices:
    """Return the samples of pairs whose own difference (P, C) is beyond the graver finite limit."""
    limit = limits[1] if np.isfinite(limits[1]) else limits[0]
    far = np.median(difference, axis=1) > limit
    return np.asarray(usable.row[np.concatenate([pairs[0][far], pairs[1][far]])])
