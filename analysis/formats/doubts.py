"""Signs that a text was cut or damaged where its format cannot say so: told with the samples, not in silence.

Most tables neither count their rows nor mark their end. What was cut inside the last number reads as another
number; what was cut between two rows reads as a smaller table, and a row that was doubled as a larger one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

ATTRIBUTE = "doubts"
FEWEST_RUNS = 3
BLOCK = 16384
SAME = 1e-9
POLE = 1.0 - 1e-12
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
    found = [str(samples.attrs[ATTRIBUTE])] if ATTRIBUTE in samples.attrs else []
    found += [UNFINISHED] if unfinished(path) else []
    for name, what in (("wi", "light"), ("wo", "view")):
        found += _short_run(samples[name].to_numpy(), what)
    found += _repeated(samples)
    return "; ".join(found)


def unfinished(path: Path) -> bool:
    """Whether a text ends within a line."""
    with path.open("rb") as stream:
        stream.seek(-min(2, path.stat().st_size), 2)
        return stream.read().replace(b"\0", b"")[-1:] not in {b"\n", b"\r"}  # UTF-16 has zero bytes


def _short_run(directions: Array, what: str) -> list[str]:
    """Say which one run of samples of a single direction is shorter than all others, which are alike.

    The last may lack any number of samples, as where a file was cut; another one a few, as where rows were
    lost.
    """
    new = np.empty(max(len(directions) - 1, 0), dtype=bool)
    for rows in _blocks(len(new)):
        step = directions[rows.start + 1 : rows.stop + 1] - directions[rows]
        new[rows] = (np.abs(step, out=step) > SAME).any(axis=1)
    runs = np.diff(np.flatnonzero(new) + 1, prepend=0, append=len(directions))
    if len(runs) < FEWEST_RUNS:
        return []
    full = int(runs.max())
    short = np.flatnonzero(runs < full)
    if len(short) != 1 or full < 2:
        return []
    length = int(runs[short[0]])
    if short[0] == len(runs) - 1:
        return [f"the last direction of {what} has {length} samples, all others have {full}"]
    if full - length <= max(2, full // 10):
        return [f"direction {short[0] + 1} of {what} has {length} samples, all others have {full}"]
    return []


def _repeated(samples: xr.Dataset) -> list[str]:
    """Say which sample stands a second time with the same value: a row was doubled, or a file put to itself.

    Where the light or the view is the normal, some formats repeat it for each azimuth: that is no sign of
    anything.
    """
    wi, wo, f_r = (samples[name].to_numpy() for name in ("wi", "wo", "f_r"))
    tables = wi, wo, f_r
    half, odd = divmod(len(wi), 2)
    if half > 1 and not odd and all(np.array_equal(each[:half], each[half:]) for each in tables):
        return ["its second half repeats the first"]
    # One number tells nearly all rows apart; the few with the same are compared in full.
    weights = np.sqrt(np.arange(2.0, 8.0 + f_r.shape[1]))
    number = wi @ weights[:3] + wo @ weights[3:6] + f_r @ weights[6:]
    order = np.argsort(number, kind="stable")
    near = np.flatnonzero(np.diff(number[order]) == 0.0)
    before, again = order[near], order[near + 1]
    same = (wi[again, 2] < POLE) & (wo[again, 2] < POLE)
    before, again = before[same], again[same]
    same = np.ones(len(again), dtype=bool)
    for each in tables:
        for rows in _blocks(len(again)):
            same[rows] &= (each[before[rows]] == each[again[rows]]).all(axis=1)
    if not same.any():
        return []
    count = np.count_nonzero(same)
    others = f" and {count - 1} others" if count > 1 else ""
    return [f"sample {again[same].min()}{others} repeat what stands before, direction and value"]


def _blocks(count: int) -> Iterator[slice]:
    """Cut rows into parts whose arrays stay in the cache: a long table is looked through thrice as fast."""
    return (slice(at, min(at + BLOCK, count)) for at in range(0, count, BLOCK))
