"""The convention doctor: which reading of a file agrees with physics, and whether the evidence decides.

Readings that give the same samples, with light and view exchanged, mirrored or turned together, count as one:
no measurement of an isotropic, reciprocal surface tells them apart. So do readings that give the same f_r
within noise (`doctor_same`). Each is weighed by its evidence (`doctor_evidence`), by the share of its samples
that lie above the horizon, and by its number of steps; what is decided has to stand without the grazing
samples. Nothing is changed unless `reread` is called.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis import formats
from analysis.angle_table import AngleTable, table_of
from analysis.doctor_advice import what_would_decide
from analysis.doctor_readings import Reading, candidates
from analysis.doctor_same import EXACTLY, alike, grouped, signature_of
from analysis.doctor_weighing import Ranked, Weighing
from analysis.formats.doubts import ATTRIBUTE, doubts
from analysis.samples import make_samples, read
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

MOST_SAMPLES = 1500
SCREENED = 250
"""Samples on which all readings are weighed first."""
KEPT = 10
"""Readings, best first, that are weighed again on all samples."""
DECIDED = float(np.log(200.0))
"""Logarithm of the odds at which the evidence decides."""
NOISE_FLOOR = 0.02
"""Relative standard uncertainty that every value has at least."""


RISING = 10.0
"""Logarithm of the odds, near the normal, from which values are believed that lack cos(theta_i) cos(theta_o).

Apertures and footprints take away where a peak is narrow or lies low, as those cosines do. Nothing adds
there: the other way round the evidence of all angles counts.
"""


@dataclass(frozen=True)
class Diagnosis:
    """Readings, best first.

    Attributes
    ----------
    ranked : tuple of Ranked
        Empty where too few samples make sense under any reading.
    count : int
        How many samples were looked at.
    to_decide : str
        What measurement tells the readings apart that are left open; empty where the evidence decides.
    """

    ranked: tuple[Ranked, ...]
    count: int
    to_decide: str = ""

    @property
    def decided(self) -> bool:
        """Whether the best is far enough ahead of the others, and not as far behind without grazing ones."""
        return bool(self.ranked) and len(self.open) == 1

    @property
    def open(self) -> tuple[Ranked, ...]:
        """The readings that the evidence does not rule out, the best first."""
        return tuple(each for place, each in enumerate(self.ranked) if not place or self._rivals(each))

    def _rivals(self, other: Ranked) -> bool:
        best = self.ranked[0]
        if other.log_odds >= -DECIDED or other.log_odds_steep >= best.log_odds_steep + DECIDED:
            return True
        light, view = (a - b for a, b in zip(best.reading.powers, other.reading.powers, strict=True))
        rises = best.reading.turned == other.reading.turned and light == view < 0
        return rises and other.log_odds_near > best.log_odds_near - RISING

    @property
    def as_declared(self) -> bool:
        """Whether the file as declared is decided for, or at least not ruled out."""
        return any(not reading.steps for each in self.open for reading in each.group)

    @property
    def words(self) -> str:
        """What a person should know, in one sentence."""
        if not self.ranked:
            return "too few samples make sense under any reading"
        if not self.decided:
            return "the evidence does not decide between: " + "; ".join(r.reading.words for r in self.open)
        best = self.ranked[0]
        words = best.reading.words if best.reading.steps else "the conventions are as declared"
        also = "; or ".join(reading.words for reading in best.alike)
        return f"{words}; the same within noise: {also}" if also else words


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
            why = _doubts(declared, path) if getattr(module, "OPEN_END", False) else ""
            return replace(declared, attributes={ATTRIBUTE: why} if why else {})
    return table_of(read(path, **options))


def _doubts(table: AngleTable, path: Path) -> str:
    import xarray as xr

    columns = {"wi": table.wi, "wo": table.wo, "f_r": table.f_r}
    return doubts(xr.Dataset({name: (("sample", name), each) for name, each in columns.items()}), path)


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
    every = np.arange(0, len(weights), max(len(weights) // SCREENED, 1))
    screened = Weighing(few.rows(every), weights[every], quick=True).ranked(grouped(few, candidates()))
    kept = [[each.reading, *each.same] for each in screened[:KEPT]]
    weighed = Weighing(few, weights, quick=False).ranked(kept)
    if not weighed:
        return Diagnosis((), len(weights))
    best = weighed[0]
    ranked = [
        replace(
            each,
            log_odds=each.log_odds - best.log_odds,
            log_odds_steep=_against(each.log_odds_steep, best.log_odds_steep),
            log_odds_near=_against(each.log_odds_near, best.log_odds_near),
        )
        for each in weighed
    ]
    found = Diagnosis(tuple(_joined(ranked, few)), len(weights))
    return replace(found, to_decide=what_would_decide([each.reading for each in found.open], few))


def _against(log: float, best: float) -> float:
    """Return a logarithm of odds; 0 where the best has none."""
    return log - best if np.isfinite(best) else 0.0


def same_within_noise(table: AngleTable, first: Reading, second: Reading) -> bool:
    """Whether two readings of a table give the same f_r in the same directions, within noise.

    Parameters
    ----------
    table : AngleTable
        Angles and values as declared.
    first, second : Reading
        Two ways to take them.
    """
    few, _ = _thinned(table)
    a, b = first.apply(few), second.apply(few)
    exactly = np.max(np.abs(signature_of(a) - signature_of(b)), initial=0.0) < EXACTLY
    return bool(exactly) or alike(a, b)


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
        Attributes `reading`, `reading_words`, `reading_left_out`, which also say what was done before. Of the
        uncertainties only `u_f_r` is kept.

    Raises
    ------
    BadInput
        If no sample is left.
    """
    read = reading.apply(table)
    above = read.possible()
    if not above.any():
        raise BadInput("no sample lies above the horizon", where=reading.name, todo="choose another reading")
    kept = read.rows(above)
    samples = make_samples(kept.wi, kept.wo, kept.f_r, **kept.facts)
    before = {
        name: f"{table.attributes[name]}, then "
        for name in ("reading", "reading_words")
        if name in table.attributes
    }
    return samples.assign_attrs(
        table.attributes
        | {
            "reading": before.get("reading", "") + reading.name,
            "reading_words": before.get("reading_words", "") + reading.words,
            "reading_left_out": int(np.count_nonzero(~above)),
        }
    )


def _thinned(table: AngleTable) -> tuple[AngleTable, Array]:
    """Return the usable samples, some of many, in the mean over channels, and the weight of each.

    Their only fact is the stated uncertainty `u_f_r`, where all of them have one.
    """
    finite = np.asarray(np.isfinite(table.f_r).all(axis=1))
    if "flags" in table.facts:
        finite &= (table.facts["flags"] == 0).all(axis=1)
    value = np.where(finite, np.mean(np.where(finite[:, None], table.f_r, 0.0), axis=1), np.nan)
    good = np.flatnonzero(value > 0.0)
    floor = _noise_about_zero(value[finite])
    if len(good) > MOST_SAMPLES:
        good = np.sort(np.random.default_rng(0).choice(good, MOST_SAMPLES, replace=False))
    few = replace(table.rows(good), f_r=value[good][:, None], facts={})
    variance = NOISE_FLOOR**2 + np.square(floor / value[good])
    if "u_f_r" in table.facts:
        # The channels' errors are taken as common: the mean's is then the mean of theirs.
        u_f_r = np.abs(np.mean(table.facts["u_f_r"][good], axis=1))
        variance += np.square(np.where(np.isfinite(u_f_r), u_f_r, 0.0) / value[good])
        if np.isfinite(u_f_r).all() and (u_f_r > 0.0).all():
            few = replace(few, facts={"u_f_r": u_f_r[:, None]})
    return few, np.asarray(NOISE_FLOOR**2 / variance)


def _noise_about_zero(value: Array) -> float:
    """Return the size of the noise that values near 0 show, 0 where none is negative or exactly 0.

    Where all negative values became 0, as many values lie as little above 0 as lay below it.
    """
    below = value[value < 0.0]
    if not below.size:
        below = np.sort(value[value > 0.0])[: np.count_nonzero(value == 0.0)]
    return float(np.sqrt(np.mean(np.square(below)))) if below.size else 0.0


def _joined(ranked: Sequence[Ranked], table: AngleTable) -> list[Ranked]:
    """Let readings that the evidence does not rule out, and are the best within noise, be one with it.

    It is called by the simplest of them: what is as declared within noise is as declared.
    """
    best, *others = ranked
    read = best.reading.apply(table)
    rivals = Diagnosis(tuple(ranked), len(table.f_r)).open[1:]
    joined = [each for each in rivals if alike(read, each.reading.apply(table))]
    if not joined:
        return list(ranked)
    first, *more = sorted((best, *joined), key=lambda each: len(each.reading.steps))
    alike_too = tuple(reading for each in more for reading in (each.reading, *each.same))
    named = replace(best, reading=first.reading, same=first.same, alike=alike_too)
    return [named, *(each for each in others if each not in joined)]
