"""The convention doctor: which reading of a file agrees with physics, and whether the evidence decides.

Readings that give the same samples, with light and view exchanged, mirrored or turned together, count as one:
no measurement of an isotropic, reciprocal surface tells them apart. Each is weighed by `evidence`, by the
share of its samples that lie above the horizon, and by how rare such a mistake is. Nothing is changed unless
`reread` is called.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis import formats
from analysis.angle_table import AngleTable, table_of
from analysis.doctor_evidence import LENGTHS, Evidence, evidence
from analysis.doctor_readings import Reading, Step, candidates
from analysis.pairing import FEWEST_PAIRS, isotropic_key, reciprocal_difference
from analysis.samples import make_samples, read
from rig.angles import wrap
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

MOST_SAMPLES = 1000
SCREENED = 250
"""Samples on which all readings are weighed first."""
KEPT = 8
"""Readings, best first, that are weighed again on all samples."""
INDEPENDENT = 100.0
"""Samples that the evidence counts as independent, at most: neighbours share what no model describes."""
LOBE_INDEPENDENT = 40.0
"""The same for the deviation from the best lobe, which is broader."""
LOBE_KNOWN = 0.2
"""RMS about the best lobe below which no reading is better for it: no surface follows a formula so far."""
CLEAR_NOISE = 0.2
"""RMS of what is neither lobe nor smooth beyond which the odds shrink with its square: no apt model."""
DECIDED = float(np.log(5000.0))
"""Logarithm of the odds at which the evidence decides."""
FEWEST = 20
MOST_IMPOSSIBLE, ALLOWED_IMPOSSIBLE, PER_IMPOSSIBLE = 0.3, 0.02, 600.0
"""Share of samples below the horizon that rules out a reading, that is free, and the cost of the rest."""
NARROW, NARROW_COST = float(np.radians(3.0)), 25.0
"""Nobody measures within this angle of the normal only."""
COMPARED = float(np.radians(82.0))
FAVOUR = (2.0, 0.0, -4.0)
"""Logarithm of the prior odds by the number of steps: files are mostly what they say."""
RARE = {Step.WITH_COS_I: -2.0, Step.OVER_COS_I: -5.0}
"""Logarithm of the prior odds of rare mistakes: nobody divides by the light's cosine twice."""
SAME = 1e-6
NOISE_FLOOR = 0.02
"""Relative standard uncertainty that every value has at least."""


@dataclass(frozen=True)
class Ranked:
    """A reading, or several that give the same samples.

    Attributes
    ----------
    reading : Reading
        The simplest of them.
    same : tuple of Reading
        The others.
    log_odds : float
        Natural logarithm of its odds against the best.
    above_horizon : float
        Share of the samples with both directions above the horizon.
    reciprocity : float
        Median relative difference of reciprocal pairs; NaN where there are too few.
    evidence : Evidence
        What speaks for it.
    """

    reading: Reading
    same: tuple[Reading, ...]
    log_odds: float
    above_horizon: float
    reciprocity: float
    evidence: Evidence


@dataclass(frozen=True)
class Diagnosis:
    """Readings, best first; `count` samples were looked at."""

    ranked: tuple[Ranked, ...]
    count: int

    @property
    def decided(self) -> bool:
        """Whether the best is far enough ahead of the second."""
        return len(self.ranked) == 1 or (len(self.ranked) > 1 and self.ranked[1].log_odds < -DECIDED)

    @property
    def open(self) -> tuple[Ranked, ...]:
        """The readings that the evidence does not rule out."""
        return tuple(each for each in self.ranked if each.log_odds >= -DECIDED)

    @property
    def as_declared(self) -> bool:
        """Whether the file as declared is decided for, or at least not ruled out."""
        return any(not reading.steps for each in self.open for reading in (each.reading, *each.same))

    @property
    def words(self) -> str:
        """What a person should know, in one sentence."""
        if not self.ranked:
            return "too few samples make sense under any reading"
        if self.decided:
            best = self.ranked[0]
            return "the conventions are as declared" if not best.reading.steps else best.reading.words
        return "the evidence does not decide between: " + "; ".join(r.reading.words for r in self.open)


def declared_table(path: Path, options: dict[str, Any]) -> AngleTable:
    """Return a file's angles as its format declares them, whether or not they make sense.

    Formats that hold angles in columns give them as they are; of others the directions are taken.

    Parameters
    ----------
    path : Path
        The file, or a session's folder.
    options : dict
        What the format offers, see `analysis.samples.read`.

    Raises
    ------
    BadInput
        If the file cannot be read.
    """
    if not path.is_dir() and not any(value not in {None, False} for value in options.values()):
        module = formats.recognise(path)
        declared: AngleTable | None = module.declared(path) if hasattr(module, "declared") else None
        if declared is not None:
            return declared
    return table_of(read(path, **options))


def diagnose(table: AngleTable) -> Diagnosis:
    """Rank the readings of a table.

    Parameters
    ----------
    table : AngleTable
        Angles and values as declared. Samples with a flag or without a positive value are left out, and of
        many some are drawn.

    Returns
    -------
    Diagnosis
        Without readings where fewer than 20 samples are left.
    """
    few, weights = _thinned(table)
    weighed = _weighed(_grouped(few, candidates()), few, weights, every=len(weights) // SCREENED)
    weighed = _weighed([[each.reading, *each.same] for each in weighed[:KEPT]], few, weights)
    if not weighed:
        return Diagnosis((), len(weights))
    clearest = weighed[0].evidence.noise_rms
    trust = min(1.0, (CLEAR_NOISE / max(clearest, 1e-9)) ** 2)
    best = weighed[0].log_odds
    ranked = (replace(each, log_odds=trust * (each.log_odds - best)) for each in weighed)
    return Diagnosis(tuple(ranked), len(weights))


def reread(table: AngleTable, reading: Reading) -> xr.Dataset:
    """Return the samples that a table holds under a reading; the reading is recorded in the attributes.

    Parameters
    ----------
    table : AngleTable
        Angles and values as declared.
    reading : Reading
        How to take them. Samples that it puts at or below the horizon are left out and counted.

    Returns
    -------
    xarray.Dataset
        Attributes `reading`, `reading_words`, `reading_left_out`. Of the uncertainties only `u_f_r` is kept.

    Raises
    ------
    BadInput
        If no sample is left.
    """
    read = reading.apply(table)
    above = read.possible()
    if not above.any():
        raise BadInput("no sample lies above the horizon", where=reading.name, todo="choose another reading")
    factor = reading.apply(replace(table, f_r=np.ones((len(above), 1)))).f_r[above]
    by_sample = ("u_f_r", "flags")
    facts = {name: each for name, each in table.facts.items() if name not in by_sample}
    if "flags" in table.facts:
        facts["flags"] = table.facts["flags"][above]
    if "u_f_r" in table.facts:
        facts["u_f_r"] = table.facts["u_f_r"][above] * factor
    samples = make_samples(read.wi[above], read.wo[above], read.f_r[above], **facts)
    return samples.assign_attrs(
        reading=reading.name,
        reading_words=reading.words,
        reading_left_out=int(np.count_nonzero(~above)),
    )


def _thinned(table: AngleTable) -> tuple[AngleTable, Array]:
    """Return the usable samples, some of many, in the mean over channels, and the weight of each."""
    finite = np.asarray(np.isfinite(table.f_r).all(axis=1))
    if "flags" in table.facts:
        finite &= (table.facts["flags"] == 0).all(axis=1)
    value = np.where(finite, np.mean(np.where(finite[:, None], table.f_r, 0.0), axis=1), np.nan)
    good = np.flatnonzero(value > 0.0)
    negative = value[value < 0.0]
    floor = float(np.sqrt(np.mean(np.square(negative)))) if negative.size else 0.0
    if len(good) > MOST_SAMPLES:
        good = np.sort(np.random.default_rng(0).choice(good, MOST_SAMPLES, replace=False))
    few = replace(table.rows(good), f_r=value[good][:, None])
    variance = NOISE_FLOOR**2 + np.square(floor / value[good])
    return few, np.asarray(NOISE_FLOOR**2 / variance)


def _weighed(
    groups: Sequence[Sequence[Reading]], table: AngleTable, weights: Array, every: int = 1
) -> list[Ranked]:
    """Weigh readings on every n-th sample; best first, without those that are impossible."""
    rows = np.arange(0, len(weights), max(every, 1))
    lengths = LENGTHS if every <= 1 else LENGTHS[1:2]
    found = [_weigh(same, table.rows(rows), weights[rows], lengths) for same in groups]
    return sorted((each for each in found if each is not None), key=lambda each: -each.log_odds)


def _weigh(
    same: Sequence[Reading], table: AngleTable, weights: Array, lengths: Sequence[float]
) -> Ranked | None:
    """Weigh readings that are one; None where too few samples are possible under them."""
    read = same[0].apply(table)
    possible = read.possible()
    share = float(possible.mean()) if possible.size else 0.0
    largest = np.maximum(np.abs(read.theta_i), np.abs(read.theta_o))
    use = possible & (largest < COMPARED)
    if share < 1.0 - MOST_IMPOSSIBLE or np.count_nonzero(use) < FEWEST:
        return None
    compared = read.rows(use)
    found = evidence(compared, weights[use], lengths)
    log = min(INDEPENDENT, float(len(weights))) * found.total
    log -= LOBE_INDEPENDENT * float(np.log(np.hypot(found.lobe_rms, LOBE_KNOWN)))
    log -= PER_IMPOSSIBLE * max(1.0 - share - ALLOWED_IMPOSSIBLE, 0.0)
    log -= NARROW_COST if largest.max() < NARROW else 0.0
    log += FAVOUR[len(same[0].steps)] + max(sum(RARE.get(step, 0.0) for step in r.steps) for r in same)
    return Ranked(same[0], tuple(same[1:]), log, share, _reciprocity(compared), found)


def _reciprocity(table: AngleTable) -> float:
    difference = reciprocal_difference(table.wi, table.wo, table.f_r)
    return float(np.median(difference)) if len(difference) >= FEWEST_PAIRS else float("nan")


def _grouped(table: AngleTable, readings: Sequence[Reading]) -> list[list[Reading]]:
    """Put readings together that give the same samples, simplest first."""
    groups: list[tuple[Array, list[Reading]]] = []
    for reading in readings:
        signature = signature_of(reading.apply(table))
        for known, members in groups:
            if np.max(np.abs(known - signature), initial=0.0) < SAME:
                members.append(reading)
                break
        else:
            groups.append((signature, [reading]))
    return [members for _, members in groups]


def signature_of(table: AngleTable) -> Array:
    """Return samples (N, 4 + C) up to exchange of light and view, mirroring, and turning of the surface.

    Samples below the horizon are all alike.
    """
    # The sign of a polar angle is half a turn of the azimuth.
    back = (table.theta_i < 0.0).astype(np.float64) - (table.theta_o < 0.0)
    turn = np.abs(wrap(table.phi_o - table.phi_i + np.pi * back))
    polar = np.sort(np.abs(np.stack([table.theta_i, table.theta_o])), axis=0)
    # Values of files span many decades: the logarithm, with a sign.
    values = np.sign(table.f_r) * np.log1p(np.abs(table.f_r) * 1e9)
    signature = np.concatenate([isotropic_key(polar[0], polar[1], turn), values], axis=1)
    return np.where(table.possible()[:, None], signature, 0.0)
