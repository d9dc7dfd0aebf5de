"""A fit's parameters as rows for people: one per parameter and channel, beside the truth where known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from analysis.fit import FitResult


@dataclass(frozen=True)
class Row:
    """One number of a fit.

    Attributes
    ----------
    name : str
        Parameter, or derived quantity.
    channel : str
        Channel's label; empty for a parameter that all channels share.
    value, u : float
        Value and standard uncertainty (k = 1).
    true : float or None
        The value that made the data, where somebody knows it.
    """

    name: str
    channel: str
    value: float
    u: float
    true: float | None

    @property
    def pull(self) -> float | None:
        """(value - true) / u, or None without a truth or an uncertainty."""
        if self.true is None or not self.u > 0:
            return None
        return (self.value - self.true) / self.u


def parameter_rows(
    result: FitResult, channels: Sequence[str], truth: Mapping[str, ArrayLike] | None = None
) -> list[Row]:
    """List a fit's parameters and derived quantities, channel by channel.

    Parameters
    ----------
    result : FitResult
        The fit.
    channels : sequence of str
        Labels of the channels.
    truth : mapping of str to float or (C,), optional
        True values by name.
    """
    numbers = {name: (value, result.u[name]) for name, value in result.parameters.items()}
    numbers |= result.derived
    rows = []
    for name, (value, u) in numbers.items():
        values, us = np.atleast_1d(value), np.atleast_1d(u)
        known = (
            None
            if truth is None or name not in truth
            else np.atleast_1d(np.asarray(truth[name], dtype=float))
        )
        for index in range(values.size):
            label = channels[index] if values.size > 1 else ""
            true = None if known is None else float(known[min(index, known.size - 1)])
            rows.append(Row(name, label, float(values[index]), float(us[min(index, us.size - 1)]), true))
    return rows


def rounded(value: float, u: float) -> tuple[str, str]:
    """Write a value and its standard uncertainty with two significant digits of the uncertainty.

    >>> rounded(0.200134, 0.00042)
    ('0.20013', '0.00042')
    """
    if not (math.isfinite(u) and u > 0 and math.isfinite(value)):
        return f"{value:.6g}", "" if not math.isfinite(u) else f"{u:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(u)))
    if decimals > 9:
        return f"{value:.6g}", f"{u:.1e}"
    return f"{value:.{decimals}f}", f"{u:.{decimals}f}"


def text_table(rows: Sequence[Row]) -> str:
    """Set rows as aligned plain text, with true values and pulls where they are known."""
    header = ("parameter", "true", "recovered", "u (k=1)", "pull")
    lines = [header]
    for row in rows:
        value, u = rounded(row.value, row.u)
        name = f"{row.name} {row.channel}".rstrip()
        true = "" if row.true is None else f"{row.true:.6g}"
        pull = "" if row.pull is None else f"{row.pull:+.2f}"
        lines.append((name, true, value, u, pull))
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
