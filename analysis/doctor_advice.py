"""What measurement would decide between readings that a file's own samples leave open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.angle_table import AngleTable
    from analysis.doctor_readings import Reading

LARGEST_THETA = float(np.radians(75.0))
"""Beyond it nobody is sent to measure a reference."""
TOLD_APART = 1.1
"""Ratio of values from which a white reference tells readings apart."""


def what_would_decide(readings: Sequence[Reading], table: AngleTable) -> str:
    """Return the measurements that tell readings apart, in words; empty where there is but one.

    Where readings differ in directions, a peak whose place is known tells them apart; where they differ in a
    factor, a surface whose f_r is known does, at the angles where the factor is largest.

    Parameters
    ----------
    readings : sequence of Reading
        Those that are left open, the best first.
    table : AngleTable
        The samples, as declared.
    """
    if len(readings) < 2:
        return ""
    turned = {reading.turned for reading in readings}
    asked = [_reference(readings, table)]
    if len(turned) > 1:
        asked.append(
            "a mirror or a glossy sample, with the light well off the normal: its peak has to lie at the "
            "mirror direction, and only the right reading puts it there"
        )
    found = [each for each in asked if each]
    return f"to decide, measure in the same way: {'; and '.join(found)}" if found else ""


def _reference(readings: Sequence[Reading], table: AngleTable) -> str:
    """Return where a white reference tells the best reading from one with another factor."""
    best = readings[0]
    rivals = [reading for reading in readings[1:] if reading.turned == best.turned]
    if not rivals:
        return ""
    read = best.apply(table)
    size = np.maximum(np.abs(read.theta_i), np.abs(read.theta_o))
    use = np.flatnonzero(read.possible() & (size < LARGEST_THETA) & (read.f_r[:, 0] > 0.0))
    if not len(use):
        return ""
    ratio = rivals[0].apply(table).f_r[use, 0] / read.f_r[use, 0]
    place = int(np.argmax(np.abs(np.log(ratio))))
    most = float(np.exp(abs(np.log(ratio[place]))))
    if most < TOLD_APART:
        return "a white reference of known f_r at larger angles than these: here the readings hardly differ"
    theta_i, theta_o = (np.degrees(abs(theta[use[place]])) for theta in (read.theta_i, read.theta_o))
    return (
        f"a white reference of known f_r, such as with theta_i = {theta_i:.0f} deg and theta_o = "
        f"{theta_o:.0f} deg: there {best.name} and {rivals[0].name} differ by a factor of {most:.2g}"
    )
