"""The convention doctor against files that were corrupted on purpose: how often right, wrong, undecided.

A file of another laboratory, or a synthetic surface with noise, is taken as right. A random mistake of
convention, at times two, is made in its angles or values, samples are left out and noise is added; the doctor
is asked which reading undoes the mistake. It is right if it decides for that reading, or for one that gives
the same f_r within noise. Corruptions that change nothing beyond noise are not distinguishable, and not
counted. All files are also shown to it as they are.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.angle_table import AngleTable, table_of
from analysis.doctor import Diagnosis, diagnose, same_within_noise
from analysis.doctor_readings import COSINES, INVERSE, Reading, Step
from analysis.models import MODELS
from analysis.samples import make_samples, read
from benchmarks.rows import row
from rig.angles import spherical_to_direction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import xarray as xr

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FIRST_SEED, SEEDS = 7000, 200
"""Seeds of the study, which nothing was chosen on; 0 to 5199 and 20000 to 20399 were looked at."""
RIGHT_PERCENT, WRONG_PERCENT, LONGEST_S = 95.0, 1.0, 5.0
MISTAKES = tuple(Step)
TWO_MISTAKES = 0.15
FEWEST_KEPT = 600
MATERIALS = ("Alu sandgestrahlt", "Edelstahl gebürstet", "Kupfer", "Referenzlack (Rau)")
SYNTHETIC = {
    "ggx": {"kd": 0.3, "ks": 1.0, "alpha": 0.25, "f0": 0.05},
    "cook-torrance-schlick": {"kd": 0.05, "ks": 0.8, "m": 0.35, "f0": 0.6},
    "ward-duer": {"kd": 0.5, "ks": 0.1, "alpha": 0.15},
    "oren-nayar": {"kd": 0.6, "sigma_rad": 0.4},
}


@dataclass(frozen=True)
class Trial:
    """One corruption and what the doctor said.

    Attributes
    ----------
    source : str
        The file, or the synthetic surface.
    mistake : Reading
        What undoes the corruption.
    distinguishable : bool
        Whether the corrupted samples are others than the true ones, beyond noise.
    verdict : str
        Right, wrong or undecided.
    named : tuple of str
        The readings that the doctor left open, or decided for.
    cpu_s : float
        What the diagnosis took.
    """

    source: str
    mistake: Reading
    distinguishable: bool
    verdict: str
    named: tuple[str, ...]
    cpu_s: float


def sources() -> dict[str, Callable[[], xr.Dataset]]:
    """Return how to read each file, and how to make each synthetic surface."""
    made: dict[str, Callable[[], xr.Dataset]] = {name: partial(synthetic, name) for name in SYNTHETIC}
    for pattern in ("merl-standins/*.npz", "cornell/*.brdf", "rgl/*.bsdf", "starlink/chassis*.csv"):
        made |= {path.stem: partial(read, path) for path in sorted(DATA.glob(pattern))}
    raw = DATA / "rt300s" / "raw"
    for path in (*sorted(raw.glob("*EC1*.xls")), *sorted(raw.glob("NiTE*.xls"))):
        made[path.stem] = partial(read, path, blank=raw / "blank_v2o0_20250911.xls")
    for material in MATERIALS if (DATA / "mwir").is_dir() else ():
        made[material] = partial(read, DATA / "mwir" / "radiance.csv", material=material)
    return made


def synthetic(name: str) -> xr.Dataset:
    """Return a model on a grid that nobody chose for it: a few incidences, views over the hemisphere."""
    theta_i, theta_o, phi = np.meshgrid(
        np.radians([7.0, 25.0, 45.0, 60.0, 72.0]),
        np.radians(np.arange(4.0, 81.0, 7.0)),
        np.arange(0, 6.2, 0.3),
    )
    wi = spherical_to_direction(theta_i.ravel(), np.full(theta_i.size, 2.0))
    wo = spherical_to_direction(theta_o.ravel(), phi.ravel())
    return make_samples(wi, wo, MODELS[name](**SYNTHETIC[name]).evaluate(wi, wo)[:, :1])


@cache
def _table(name: str) -> AngleTable:
    samples = sources()[name]()
    usable = (samples["flags"].to_numpy() == 0).all(axis=1)
    return table_of(samples).rows(usable)


def undone(mistake: Reading) -> Reading:
    """Return the reading that makes a mistake, which `mistake` then undoes."""
    return Reading(tuple(INVERSE.get(step, step) for step in reversed(mistake.steps)))


def corrupted(name: str, random: np.random.Generator) -> tuple[AngleTable, Reading]:
    """Return a file's samples with a mistake, and the reading that undoes it."""
    table = _table(name)
    share = max(random.uniform(0.5, 1.0), FEWEST_KEPT / len(table.f_r))
    table = table.rows((random.random(len(table.f_r)) < share) & table.possible())
    noise = random.uniform(0.0, 0.03)
    facts = dict(table.facts)
    if "u_f_r" in facts:
        facts["u_f_r"] = np.hypot(facts["u_f_r"], noise * np.abs(table.f_r))
    table = replace(
        table, f_r=table.f_r * np.exp(noise * random.standard_normal(table.f_r.shape)), facts=facts
    )
    steps = [Step(random.choice([step.value for step in MISTAKES]))]
    if steps[0] not in COSINES and random.random() < TWO_MISTAKES:
        steps.append(Step(random.choice([Step.WITH_COS_O.value, Step.OVER_COS_O.value])))
    mistake = Reading(tuple(steps))
    return undone(mistake).apply(table), mistake


def trial(seed: int) -> Trial:
    """Corrupt a random file and ask the doctor."""
    random = np.random.default_rng(seed)
    name = str(random.choice(sorted(sources())))
    table, mistake = corrupted(name, random)
    begin = time.process_time()
    found = diagnose(table)
    cpu_s = time.process_time() - begin
    named = tuple(each.reading.name for each in found.open)
    distinguishable = not same_within_noise(table, Reading(), mistake)
    return Trial(name, mistake, distinguishable, _verdict(found, table, mistake), named, cpu_s)


def _verdict(found: Diagnosis, table: AngleTable, mistake: Reading) -> str:
    if not found.decided:
        return "undecided"
    group = found.ranked[0].group
    return "right" if any(same_within_noise(table, reading, mistake) for reading in group) else "wrong"


def rates(trials: Sequence[Trial]) -> dict[str, float]:
    """Return the share of distinguishable corruptions, and of these the shares of right, wrong, undecided."""
    counted = [each.verdict for each in trials if each.distinguishable]
    found = {name: counted.count(name) / max(len(counted), 1) for name in ("right", "wrong", "undecided")}
    return {"distinguishable": len(counted) / max(len(trials), 1), **found}


def false_alarms() -> list[str]:
    """Return the files that the doctor does not leave as they are, by name."""
    return [name for name in sorted(sources()) if not diagnose(_table(name)).as_declared]


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - a part's interface; there is nothing to draw
    """Study 200 seeds and all clean files: rows as `gonio bench` takes them."""
    trials = [trial(seed) for seed in range(FIRST_SEED, FIRST_SEED + SEEDS)]
    found = rates(trials)
    about = f"conventions, {SEEDS} corruptions"
    return [
        row(f"{about}: distinguishable", 100.0 * found["distinguishable"], "%"),
        row(f"{about}: right, of these", 100.0 * found["right"], "%", RIGHT_PERCENT, at_least=True),
        row(f"{about}: wrong, of these", 100.0 * found["wrong"], "%", WRONG_PERCENT),
        row(f"{about}: undecided, of these", 100.0 * found["undecided"], "%"),
        row("conventions: clean files called wrong", len(false_alarms()), "", 0.0),
        row("conventions: longest diagnosis, CPU", max(each.cpu_s for each in trials), "s", LONGEST_S),
    ]
