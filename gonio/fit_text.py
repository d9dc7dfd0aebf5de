"""Fits as people read them: the ranking, what it means, each model's parameters; files side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.comparison import in_words
from analysis.factored_fit import FactoredFit
from analysis.table import rounded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from analysis.comparison import Candidate
    from analysis.differences import Difference
    from analysis.models.factored import Table
    from analysis.ranking import AnyFit

METRICS = {
    "rms_log": "rms_log",
    "l2_cos": "l2_cos",
    "rms_cbrt": "rms_cbrt",
    "median_relative": "median rel.",
    "chi2_dof": "chi2/dof",
}
MOST_CHANNELS = 4
"""Channels up to which each has its line; more become a range."""
MASKED = {
    "beyond_max_theta": "beyond --max-theta-deg",
    "flagged": "flagged",
    "below_horizon": "below the horizon",
    "without_value": "without a value",
    "without_uncertainty": "without an uncertainty",
    "gross_error": "far from the best model",
}


def page(
    file: str,
    channels: Sequence[str],
    ranked: Sequence[Candidate],
    *,
    masked: Mapping[str, int],
    left_out: Mapping[str, str],
) -> str:
    """Set one file's fits: the ranking, what it means, then each model's parameters."""
    first = ranked[0].result
    shown = [name for name in METRICS if name in first.metrics]
    lines = [f"{file}: {first.count} data in {len(channels)} channel(s), loss {first.loss}", ""]
    heads = ["cross-val.", "BIC", *(METRICS[name] for name in shown)]
    width = max(22, *(len(each.name) + 1 for each in ranked))
    lines.append(f"{'model':<{width}}" + "".join(f"{head:>13}" for head in heads))
    for each in ranked:
        metrics = [each.result.metrics[name] for name in shown]
        cells = "".join(f"{value:>13.5g}" for value in (each.cross_validation, each.bic, *metrics))
        lines.append(f"{each.name:<{width}}{cells}")
    words = in_words(ranked)
    if words:
        lines += ["", words]
    unused = [f"{count} {MASKED[reason]}" for reason, count in masked.items() if count]
    if unused:
        lines += ["", f"data not fitted: {', '.join(unused)}"]
    if left_out:
        lines += ["", *(f"left out: {why}" for why in left_out.values())]
    for each in ranked:
        lines += ["", *_numbers(each.result, channels)]
    return "\n".join([*lines, ""])


def _numbers(result: AnyFit, channels: Sequence[str]) -> list[str]:
    """Set a model's numbers, value and standard uncertainty; many channels become a range."""
    lines = [f"{result.model.NAME}  (value, standard uncertainty)"]
    numbers = {name: (value, result.u[name]) for name, value in result.parameters.items()} | result.derived
    for name, (values, us) in numbers.items():
        if values.ndim == 0:
            lines.append(_line(name, *rounded(float(values), float(us))))
        elif values.size <= MOST_CHANNELS:
            labels = [f"{name} {channel}" for channel in channels]
            lines += [
                _line(label, *rounded(float(value), float(u)))
                for label, value, u in zip(labels, values, us, strict=True)
            ]
        else:
            span = f"{values.min():.4g} to {values.max():.4g}"
            lines.append(f"  {name:<14} {span} over {values.size} channels, u <= {np.max(us):.2g}")
    if isinstance(result, FactoredFit):
        lines += _tables(result)
    if result.message:
        lines.append(f"  note: {result.message}")
    return lines


def _tables(result: FactoredFit) -> list[str]:
    density, reflectance = result.tables["D"], result.tables["F"]
    half = np.flatnonzero(density.value < 0.5 * density.value[0])
    falls = f"falls to half by {density.theta_deg[half[0]]:.3g} deg" if half.size else "never falls to half"
    at_0, at_60 = (_at(reflectance, theta_deg) for theta_deg in (0.0, 60.0))
    return [
        f"  D(theta_h)     {density.value[0]:.4g}/sr at the normal, {falls}",
        f"  ks F(theta_d)  {at_0} at 0 deg, {at_60} at 60 deg, mean of the channels",
        f"  {result.freedom:.0f} parameters are decided by the data; --json has the tables",
    ]


def _at(table: Table, theta_deg: float) -> str:
    """Set a table's mean over the channels at an angle, with its relative uncertainty."""
    value, u = (
        float(np.interp(theta_deg, table.theta_deg, part.mean(axis=1)))
        for part in (table.value, table.relative_u)
    )
    return f"{value:.3g} +- {100.0 * u:.2g} %"


def _line(label: str, value: str, u: str) -> str:
    return f"  {label:<14} {value:>12}  {u or 'not determined':>10}"


def side_by_side(
    files: Sequence[str], channels: Sequence[str], models: Mapping[str, Sequence[Difference]]
) -> str:
    """Set each model's parameters over the files, and what differs."""
    lines = [f"[{number}] {file}" for number, file in enumerate(files, start=1)]
    for model, rows in models.items():
        table = [["", *(f"[{number}]" for number in range(1, len(files) + 1)), "difference / u", "p"]]
        for row in rows:
            label = row.parameter if row.channel is None else f"{row.parameter} {channels[row.channel]}"
            p_value = f"{row.p_value:.2g}" if np.isfinite(row.p_value) else "-"
            table.append([label, *_cells(row), f"{row.largest:.3g}", p_value])
        widths = [max(len(line[i]) for line in table) + 2 for i in range(len(table[0]))]
        lines += ["", model]
        for line, mark in zip(table, [False, *(row.differs for row in rows)], strict=True):
            cells = "".join(f"{cell:>{width}}" for cell, width in zip(line[1:], widths[1:], strict=True))
            lines.append(f"  {line[0]:<{widths[0]}}{cells}{'  differs' if mark else ''}")
    lines += [
        "",
        "'differs': by more than chance at 5 % for a model's whole table (chi-square about the mean, Holm);",
        "errors of the files are taken as independent.",
    ]
    return "\n".join(lines)


def _cells(row: Difference) -> list[str]:
    cells = []
    for value, u in zip(row.values, row.u, strict=True):
        number, spread = rounded(float(value), float(u))
        cells.append(f"{number} +- {spread}" if spread else f"{number} (open)")
    return cells
