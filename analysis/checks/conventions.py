"""The convention doctor's answer as a check."""

from __future__ import annotations

import numpy as np

from analysis.checks.finding import Finding, Verdict, not_tested
from analysis.doctor import DECIDED, Diagnosis


def conventions(diagnosis: Diagnosis) -> Finding:
    """Say whether another reading of angles and values explains the file better than the declared one."""
    name, quantity = "conventions", "logarithm of the odds of another reading over the declared one"
    limits = (0.0, DECIDED)
    if not diagnosis.ranked:
        return not_tested(name, quantity, limits, diagnosis.count, diagnosis.words)
    declared = [each.log_odds for each in diagnosis.ranked if not all(r.steps for r in each.group)]
    others = [each for each in diagnosis.ranked if all(r.steps for r in each.group)]
    best = others[0].log_odds if others else -np.inf
    value = best - declared[0] if declared else np.inf
    where = "gonio check --conventions ranks the readings"
    if not diagnosis.as_declared:
        verdict, meaning = Verdict.FAIL, f"not as declared: {diagnosis.words}"
    elif not diagnosis.decided:
        verdict, meaning = Verdict.NOT_TESTED, diagnosis.words
        where = diagnosis.to_decide or where
    else:
        verdict, meaning, where = Verdict.PASS, "", ""
    return Finding(name, quantity, float(value), *limits, diagnosis.count, verdict, meaning, where)
