"""What the convention doctor found, for people and for scripts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.doctor import Diagnosis

SHOWN_READINGS = 5
LEGEND = (
    "log odds: natural logarithm, against the best; reciprocity: median difference of exchanged directions;",
    "power: of cos(theta_i) / cos(theta_o) between neighbours of exchanged directions, 0 where reciprocal;",
    "off lobe: RMS of ln f about the best mixture of lobes, noise: about anything smooth; above: the horizon",
)


def diagnosis_entry(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis for the JSON object."""
    readings = [
        {
            "reading": each.reading.name,
            "words": each.reading.words,
            "same_as": [reading.name for reading in each.group[1:]],
            "log_odds": each.log_odds,
            "above_horizon": each.above_horizon,
            "reciprocity": each.reciprocity,
            "power": each.evidence.asymmetry.power,
            "lobe_rms": each.evidence.lobe_rms,
            "noise_rms": each.evidence.noise_rms,
        }
        for each in diagnosis.ranked
    ]
    return {
        "decided": diagnosis.decided,
        "words": diagnosis.words,
        "to_decide": diagnosis.to_decide,
        "readings": readings,
    }


def ranking(file: str, diagnosis: Diagnosis) -> list[str]:
    """Set the best readings for people, with what speaks for each, and what to do."""
    columns = f"{'log odds':>9} {'reciprocity':>12} {'power':>6} {'off lobe':>9} {'noise':>7} {'above':>6}"
    lines = [f"{file}: {diagnosis.words}", f"  from {diagnosis.count} samples", "", f"  {columns}  reading"]
    still_open = {each.reading for each in diagnosis.open}
    for each in diagnosis.ranked[:SHOWN_READINGS]:
        numbers = (
            f"{each.log_odds:9.1f} {each.reciprocity:12.3f} "
            f"{each.evidence.asymmetry.power:6.2f} {each.evidence.lobe_rms:9.2f} "
            f"{each.evidence.noise_rms:7.3f} {each.above_horizon:6.0%}"
        )
        also = f" (or {', '.join(r.name for r in each.group[1:3])})" if each.group[1:] else ""
        mark = "" if each.reading in still_open else "  ruled out"
        lines.append(f"  {numbers}  {each.reading.name}{also}{mark}")
    return [*lines, "", *(f"  {line}" for line in (*LEGEND, *_next_steps(file, diagnosis))), ""]


def _next_steps(file: str, diagnosis: Diagnosis) -> list[str]:
    """Say what a person may do about the readings; nothing was changed."""
    if not diagnosis.ranked or not any(each.reading.steps for each in diagnosis.open):
        return []
    best = next(each.reading for each in diagnosis.open if each.reading.steps)
    write = f"gonio check {file} --reading {best.name} --out FILE writes it so"
    if diagnosis.decided:
        return [f"nothing was changed; {write}"]
    return [
        each
        for each in (diagnosis.to_decide, f"nothing was changed; if you know it is {best.name}: {write}")
        if each
    ]
