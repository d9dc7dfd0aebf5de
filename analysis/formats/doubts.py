"""Signs that a text was cut short where its format cannot say so: told with the samples, never in silence.

Most tables neither count their rows nor mark their end. What was cut inside the last number reads as another
number; what was cut between two rows reads as a smaller table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

ATTRIBUTE = "doubts"
FEWEST_RUNS = 3
SAME = 1e-9
UNFINISHED = "the last line has no end: cut there, its last number would be another one"


def doubts(samples: xr.Dataset, path: Path) -> str:
    """Return why a text that was read may be cut short; empty where nothing speaks for it.

    Parameters
    ----------
    samples : xarray.Dataset
        The samples in the file's order.
    path : Path
        The text.
    """
    found = []
    with path.open("rb") as stream:
        stream.seek(-1, 2)
        if stream.read() not in {b"\n", b"\r"}:
            found.append("the last line has no end: cut there, its last number would be another one")
    for name, what in (("wi", "direction of the light"), ("wo", "direction of view")):
        length, last = _last_run(samples[name].to_numpy())
        if last < length:
            found.append(f"the last {what} has {last} samples, all others have {length}")
    return "; ".join(found)


def unfinished(path: Path) -> bool:
    """Whether a text that is not empty ends within a line."""
    with path.open("rb") as stream:
        stream.seek(-1, 2)
        return stream.read() not in {b"\n", b"\r"}


def _last_run(directions: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[int, int]:
    """Return the length that all runs of one direction but the last share, and the last's; else 0, 0."""
    new = (np.abs(np.diff(directions, axis=0)) > SAME).any(axis=1)
    runs = np.diff([0, *(np.flatnonzero(new) + 1), len(directions)])
    shared = np.unique(runs[:-1])
    if len(runs) < FEWEST_RUNS or len(shared) != 1 or shared[0] < 2:
        return 0, 0
    return int(shared[0]), int(runs[-1])
