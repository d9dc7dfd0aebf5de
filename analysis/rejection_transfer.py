"""Rejections of a person under other numbers: of samples that take the place of old ones, or of a part."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from analysis.rejection import LOG, REJECTED, Entry, log_of, numbers_of, spans, standing, with_log
from analysis.sample_matching import Matching, match_channels, match_samples
from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence, Set

    import xarray as xr


def carry_over(old: xr.Dataset, new: xr.Dataset) -> xr.Dataset:
    """Return new samples with the log of the old ones that they replace.

    Samples are found again by their directions (`analysis.sample_matching`), channels by name. Rejections
    that were taken back stay in the log, with those of their samples that are found.

    Parameters
    ----------
    old : xarray.Dataset
        The samples that a person looked at.
    new : xarray.Dataset
        The samples that take their place. Where they have a log too, one log must continue the other.

    Returns
    -------
    xarray.Dataset
        `new` itself where `old` has no log, or none that `new` has not.

    Raises
    ------
    Refused
        If a rejection stands and the number of samples has changed, one of its samples is not found again or
        cannot be told from one that is not rejected, or one of its channels is not there; or if both have
        logs of their own.
    BadInput
        If a log is damaged.
    """
    log, own = log_of(old), log_of(new)
    if not log:
        return new
    active = {entry.number for entry in standing(old)}
    before, after = (table.sizes["sample"] for table in (old, new))
    if active and before != after:
        raise Refused(f"{before} samples became {after}, which ones are rejected is not known")
    found, channels = match_samples(old, new), match_channels(old, new)
    texts = _renumbered(old, found, channels, active)
    if own:
        ours = [str(text) for text in new[LOG].to_numpy()]
        common = min(len(ours), len(texts))
        if ours[:common] != texts[:common]:
            raise Refused("both the earlier samples and the new ones have a log of rejections")
        return new if len(ours) >= len(texts) else with_log(new, texts)
    return _with_log_and_flags(new, texts)


def narrowed(samples: xr.Dataset, rows: Sequence[int], channels: Sequence[int]) -> xr.Dataset:
    """Return some samples and channels, and a log that names them by their new numbers.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples with or without a log.
    rows, channels : sequence of int
        What to keep, each once.

    Returns
    -------
    xarray.Dataset
    """
    kept = samples.isel(sample=np.asarray(rows, dtype=np.intp), channel=np.asarray(channels, dtype=np.intp))
    if LOG not in samples:
        return kept
    count = samples.sizes["sample"]
    place = np.full(count, -1, dtype=np.intp)
    place[np.asarray(rows, dtype=np.intp)] = np.arange(len(rows))
    found = Matching(place, np.arange(count), np.ones(count, dtype=bool))
    renumbered = {old: new for new, old in enumerate(channels)}
    return with_log(kept, _renumbered(samples, found, renumbered, frozenset()))


def joined(tables: Sequence[xr.Dataset], samples: xr.Dataset) -> xr.Dataset:
    """Return samples that are tables one after the other, with the logs of all of them one after the other.

    Parameters
    ----------
    tables : sequence of xarray.Dataset
        Tables of the same channels, with or without logs.
    samples : xarray.Dataset
        Their samples in the same order.

    Returns
    -------
    xarray.Dataset
        Entries and samples under their new numbers; `samples` itself where no table has a log.

    Raises
    ------
    BadInput
        If a log is damaged.
    """
    texts: list[str] = []
    start = 0
    for table in tables:
        before = len(texts)
        for entry, text in zip(log_of(table), table[LOG].to_numpy() if LOG in table else (), strict=True):
            fields = json.loads(str(text)) | {"number": entry.number + before}
            if entry.action == "reject":
                fields["samples"] = spans(numbers_of(entry.samples) + start)
            else:
                fields["of"] = entry.of + before
            texts.append(json.dumps(fields, ensure_ascii=False))
        start += table.sizes["sample"]
    return _with_log_and_flags(samples, texts) if texts else samples


def _with_log_and_flags(samples: xr.Dataset, texts: Sequence[str]) -> xr.Dataset:
    """Return samples with a log; values that are flagged as rejected without a reason stay so."""
    logged = with_log(samples, texts)
    flags = logged["flags"].to_numpy() | (samples["flags"].to_numpy() & REJECTED)
    return logged.assign(flags=logged["flags"].copy(data=flags))


def _renumbered(
    samples: xr.Dataset, found: Matching, channels: Mapping[int, int], needed: Set[int]
) -> list[str]:
    """Return the log's lines under the numbers of another table; `needed` entries must be found whole."""
    texts = []
    for entry, text in zip(log_of(samples), samples[LOG].to_numpy(), strict=True):
        fields = json.loads(str(text))
        if entry.action == "reject":
            names = _moved(entry, found, channels, stands=entry.number in needed)
            fields |= dict(zip(("samples", "channels"), names, strict=True))
        texts.append(json.dumps(fields, ensure_ascii=False))
    return texts


def _moved(
    entry: Entry, found: Matching, channels: Mapping[int, int], *, stands: bool
) -> tuple[str, list[int]]:
    """Return samples and channels of a rejection under the numbers of another table."""
    numbers, count = numbers_of(entry.samples), found.place.size
    named = np.zeros(count, dtype=bool)
    named[numbers[numbers < count]] = True
    there = named & (found.place >= 0)
    # Samples that cannot be told apart may change places where all of them are rejected.
    doubtful = np.isin(found.group, found.group[named & ~found.sure]) & ~named
    whole = there.sum() == numbers.size and channels.keys() >= set(entry.channels)
    if stands and (doubtful.any() or not whole):
        raise Refused(
            f"rejection {entry.number} by {entry.author} names samples or channels that are not found again"
        )
    kept = [channels[number] for number in entry.channels if number in channels]
    return spans(np.sort(found.place[there])), kept
