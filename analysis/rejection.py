"""Samples that a person rejects: a flag in the file, and a log of who, when and why.

The log is never shortened: variable `rejection_log`, one JSON text an entry: `number`, `action` (reject or
restore), `date` (ISO 8601, UTC), `author`, `reason`, and of a rejection `selection` (as it was asked for),
`samples` (their numbers in the file) and `channels`; of a restoration `of`, the number that it takes back.
The flag `REJECTED` of a value is set while any rejection of it stands. Nothing else of the file changes.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical, wrap
from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from datetime import datetime
    from pathlib import Path

    import xarray as xr

Indices = NDArray[np.intp]

REJECTED = 1 << 30
"""Flag of values that a person rejected; writers of samples use lower bits."""
LOG = "rejection_log"
ANGLES = ("theta_i", "theta_o", "azimuth")
_NUMBERS = re.compile(r"\A\d+(-\d+)?(,\d+(-\d+)?)*\Z")
_RANGE = re.compile(r"\A(theta_i|theta_o|azimuth)=(-?\d+(?:\.\d+)?)\.\.(-?\d+(?:\.\d+)?)\Z")


@dataclass(frozen=True)
class Entry:
    """One line of the log; see the module."""

    number: int
    action: str
    date: str
    author: str
    reason: str
    selection: str = ""
    samples: str = ""
    channels: tuple[int, ...] = ()
    of: int = 0


def log_of(samples: xr.Dataset) -> list[Entry]:
    """Return the log of samples, oldest first.

    Raises
    ------
    BadInput
        If the log is no such log.
    """
    if LOG not in samples:
        return []
    try:
        return [
            Entry(**{**(fields := json.loads(str(text))), "channels": tuple(fields.get("channels", ()))})
            for text in samples[LOG].to_numpy()
        ]
    except (ValueError, TypeError, AttributeError) as error:
        raise BadInput(f"the log of rejections is damaged ({error})", where=LOG) from error


def standing(samples: xr.Dataset) -> list[Entry]:
    """Return the rejections that nobody took back."""
    log = log_of(samples)
    restored = {entry.of for entry in log if entry.action == "restore"}
    return [entry for entry in log if entry.action == "reject" and entry.number not in restored]


def chosen(samples: xr.Dataset, selection: Sequence[str], found: Mapping[str, Indices]) -> Indices:
    """Return the numbers of the samples that a person names.

    Parameters
    ----------
    samples : xarray.Dataset
        The samples.
    selection : sequence of str
        Numbers and spans such as `3,10-20`; or ranges in degrees such as `theta_o=70..85`, `theta_i=..`,
        `azimuth=-10..10` (of the view less that of the light), all of which must hold; or one check's name.
    found : mapping of str to ndarray of int
        By check, the samples that it objects to.

    Returns
    -------
    ndarray of int
        Sorted, at least one.

    Raises
    ------
    BadInput
        If a word is none of these, or chooses nothing.
    """
    words = " ".join(selection)
    if words in found:
        numbers = np.unique(found[words])
    elif all(_NUMBERS.match(word) for word in selection):
        numbers = np.unique(np.concatenate([numbers_of(word) for word in selection]))
    elif all(_RANGE.match(word) for word in selection):
        numbers = np.flatnonzero(_in_ranges(samples, selection))
    else:
        raise BadInput(
            f"'{words}' chooses nothing",
            where="--reject",
            todo=f"give numbers (3,10-20), ranges (theta_o=70..85), or a check: {', '.join(found)}",
        )
    count = samples.sizes["sample"]
    if numbers.size and numbers[-1] >= count:
        raise BadInput(f"there is no sample {numbers[-1]}", where="--reject", todo=f"they end at {count - 1}")
    if not numbers.size:
        raise BadInput(f"no sample fits '{words}'", where="--reject", todo="choose others")
    return numbers.astype(np.intp)


def reject(
    samples: xr.Dataset,
    numbers: Indices,
    *,
    reason: str,
    author: str,
    date: datetime,
    selection: str = "",
    channels: Sequence[int] | None = None,
) -> xr.Dataset:
    """Return the samples with some of them rejected.

    Parameters
    ----------
    samples : xarray.Dataset
        The samples.
    numbers : ndarray of int
        Which to reject.
    reason, author : str
        Why, and by whom; neither may be empty.
    date : datetime
        When, with a time zone.
    selection : str
        How the person chose them.
    channels : sequence of int, optional
        Channels that are rejected; by default all.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    BadInput
        If reason or author is empty.
    """
    for name, value in (("--reason", reason), ("--author", author)):
        if not value.strip():
            raise BadInput("is empty", where=name, todo="a rejection needs a reason and a name")
    every = range(samples.sizes["channel"])
    fields = {
        "selection": selection,
        "samples": spans(numbers),
        "channels": list(every if channels is None else channels),
    }
    return _appended(samples, "reject", fields, date=date, author=author, reason=reason)


def restore(samples: xr.Dataset, number: int, *, reason: str, author: str, date: datetime) -> xr.Dataset:
    """Return the samples with one rejection taken back, by its number; see `reject`.

    Raises
    ------
    BadInput
        If no such rejection stands.
    """
    known = [entry.number for entry in standing(samples)]
    if number not in known:
        todo = f"standing: {', '.join(map(str, known))}" if known else "there is nothing to take back"
        raise BadInput(f"no rejection {number} stands", where="--restore", todo=todo)
    return _appended(samples, "restore", {"of": number}, date=date, author=author, reason=reason)


def require_store(path: Path) -> Path:
    """Return the NetCDF file where rejections can be kept.

    Raises
    ------
    Refused
        If the file's format has no place for them.
    """
    from analysis import formats
    from analysis.formats import netcdf

    path = path / formats.SESSION_FILE if path.is_dir() else path
    if not path.is_file():
        raise BadInput("no such file", where=str(path), todo="check the path")
    with path.open("rb") as stream:
        if netcdf.sniff(stream.read(len(netcdf.MAGIC))):
            return path
    raise Refused("this format has no place for rejections", where=str(path), todo="convert it to .nc first")


def spans(numbers: Indices) -> str:
    """Write sorted numbers as spans: 3,10-20; none as an empty text."""
    if not numbers.size:
        return ""
    breaks = np.flatnonzero(np.diff(numbers) != 1) + 1
    parts = np.split(numbers, breaks)
    return ",".join(str(part[0]) if len(part) == 1 else f"{part[0]}-{part[-1]}" for part in parts)


def numbers_of(word: str) -> Indices:
    """Read spans: the opposite of `spans`."""
    parts = [np.empty(0, dtype=np.intp)]
    for span in word.split(",") if word else ():
        first, _, last = span.partition("-")
        parts.append(np.arange(int(first), int(last or first) + 1, dtype=np.intp))
    return np.concatenate(parts)


def _in_ranges(samples: xr.Dataset, selection: Sequence[str]) -> NDArray[np.bool_]:
    (theta_i, phi_i), (theta_o, phi_o) = (
        direction_to_spherical(samples[name].to_numpy()) for name in ("wi", "wo")
    )
    angles = dict(zip(ANGLES, map(np.degrees, (theta_i, theta_o, wrap(phi_o - phi_i))), strict=True))
    inside = np.ones(len(theta_i), dtype=bool)
    for word in selection:
        match = _RANGE.match(word)
        if match is not None:
            low, high = float(match[2]), float(match[3])
            inside &= (angles[match[1]] >= low - 1e-9) & (angles[match[1]] <= high + 1e-9)
    return inside


def _appended(
    samples: xr.Dataset, action: str, fields: dict[str, Any], *, date: datetime, author: str, reason: str
) -> xr.Dataset:
    """Return the samples with one more entry in the log, and the flags that the log then means."""
    texts = [str(text) for text in samples[LOG].to_numpy()] if LOG in samples else []
    entry = {
        "number": len(texts) + 1,
        "action": action,
        "date": date.isoformat(timespec="seconds"),
        "author": author.strip(),
        "reason": reason.strip(),
        **fields,
    }
    texts.append(json.dumps(entry, ensure_ascii=False))
    return with_log(samples, texts)


def with_log(samples: xr.Dataset, texts: Sequence[str]) -> xr.Dataset:
    """Return the samples with that log in place of any other, and the flags that it means.

    Parameters
    ----------
    samples : xarray.Dataset
        The samples.
    texts : sequence of str
        JSON texts of the entries, oldest first.
    """
    logged = samples.drop_vars(LOG, errors="ignore").assign(
        {LOG: ("rejection", np.array(texts, dtype=object))}
    )
    flags = logged["flags"].to_numpy() & ~REJECTED
    for each in standing(logged):
        flags[np.ix_(numbers_of(each.samples), np.array(each.channels))] |= REJECTED
    return logged.assign(flags=(logged["flags"].dims, flags, logged["flags"].attrs))
