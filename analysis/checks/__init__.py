"""Checks of BRDF samples: what physics or arithmetic says about a file, before anybody believes it.

Each check gives a number, its thresholds, a verdict, what it may mean and where to look. A check that the
samples do not allow says so instead of passing. Relative differences are |a - b| / max(|a|, |b|), medians
over pairs and channels. Pairs are found by direction; where no exact reciprocal pair exists the sample is
taken as isotropic and the finding says so. Angles beyond 85 deg are left out of the comparisons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.checks.agreement import isotropy, levels, mirror_symmetry, noise, reciprocity, repeats
from analysis.checks.azimuth import azimuth_offset
from analysis.checks.finding import Finding, Verdict
from analysis.checks.hemisphere import coverage, energy
from analysis.checks.neighbours import outliers, overstated, surroundings
from analysis.checks.values import clipped, missing, negatives
from analysis.pairing import reciprocal_pairs, usable_samples

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Finding", "Verdict", "check", "worst"]


def check(samples: xr.Dataset) -> list[Finding]:
    """Run every check.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples, see `analysis.samples`.

    Returns
    -------
    list of Finding
        One for each check, in a fixed order.
    """
    usable = usable_samples(samples)
    reciprocal = reciprocal_pairs(usable)
    around = surroundings(usable)
    return [
        reciprocity(usable, reciprocal),
        levels(usable, reciprocal),
        energy(usable),
        mirror_symmetry(usable),
        azimuth_offset(usable),
        isotropy(usable),
        *repeats(usable),
        missing(samples),
        negatives(usable),
        clipped(samples),
        outliers(usable, around),
        coverage(usable),
        noise(usable, reciprocal),
        overstated(usable, around),
    ]


def worst(findings: list[Finding]) -> Verdict:
    """Return the gravest verdict; what was not tested counts as passed."""
    order = [Verdict.PASS, Verdict.NOT_TESTED, Verdict.WARN, Verdict.FAIL]
    gravest = max((finding.verdict for finding in findings), key=order.index, default=Verdict.PASS)
    return Verdict.PASS if gravest is Verdict.NOT_TESTED else gravest
