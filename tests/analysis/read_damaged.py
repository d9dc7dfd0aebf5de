"""A process that reads the files it is told, one a line, and answers with one JSON line each.

Its memory may grow by `ROOM` at most, so that a reader that believes a damaged header fails here.
"""

from __future__ import annotations

import hashlib
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

from analysis.formats import alta, astm, cornell, csv, fred, inplane, klems, merl, npz, pab, rgl, ssdd, zemax
from analysis.samples import read
from rig.errors import BadInput

ROOM = 1024**3
MOST_ROWS = 100_000
"""Of which each has a digest of its own; larger tables have one."""

WARM = (alta, astm, cornell, csv, fred, inplane, klems, merl, npz, pab, rgl, ssdd, zemax)
"""Imported before memory is limited."""


def main() -> None:
    """Answer until the input ends."""
    limit_memory()
    for line in sys.stdin:
        started = time.process_time()
        answer = outcome(Path(line.rstrip("\n")))
        seconds, peak_kb = time.process_time() - started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        sys.stdout.write(json.dumps([*answer, seconds, peak_kb / 1024]) + "\n")
        sys.stdout.flush()


def limit_memory() -> None:
    """Allow `ROOM` more than is taken now, where the system can."""
    import h5netcdf  # noqa: F401
    import xarray  # noqa: F401
    import xlrd  # noqa: F401

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + ROOM
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def outcome(path: Path) -> tuple[str, str, list[str]]:
    """Return what happened: the samples' digest and those of their rows, or the complaint."""
    try:
        samples = read(path)
    except BadInput as error:
        return "refused", str(error), []
    except BaseException as error:  # noqa: BLE001 - what must not happen is told, not raised
        return "failed", f"{type(error).__name__}: {error}", []
    columns = [samples[name].to_numpy() for name in ("wi", "wo", "f_r")]
    if len(columns[0]) > MOST_ROWS:
        whole = hashlib.md5(b"".join(column.tobytes() for column in columns), usedforsecurity=False)
        return "read", str(samples.attrs.get("doubts", "")), [whole.hexdigest()]
    rows = [
        hashlib.md5(row.tobytes(), usedforsecurity=False).hexdigest()[:8]
        for row in np.concatenate(columns, axis=1)
    ]
    return "read", str(samples.attrs.get("doubts", "")), rows


if __name__ == "__main__":
    main()
