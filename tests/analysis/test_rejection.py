"""Rejected samples: flagged, logged, taken back; nothing else of the file changes, fits leave them out."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from analysis.fit import fit
from analysis.joining import join
from analysis.rejection import (
    LOG,
    REJECTED,
    chosen,
    log_of,
    reject,
    require_store,
    restore,
    spans,
    standing,
)
from analysis.rejection_transfer import carry_over, narrowed
from analysis.samples import make_samples, read, select, write
from rig.angles import spherical_to_direction
from rig.errors import BadInput, Refused

WHEN = datetime(2026, 5, 4, 3, 2, 1, tzinfo=UTC)
WHO = {"reason": "stray light", "author": "Ada", "date": WHEN}


@pytest.fixture
def samples():
    """Return 40 samples in two channels, one of which somebody flagged already."""
    wi = spherical_to_direction(np.full(40, 0.5), np.pi)
    wo = spherical_to_direction(np.linspace(0.01, 1.4, 40), np.linspace(-0.5, 0.5, 40))
    f_r = np.stack([np.linspace(0.1, 0.2, 40), np.linspace(0.2, 0.1, 40)], axis=1)
    flags = np.zeros((40, 2), dtype=int)
    flags[7] = 4
    made = make_samples(wi, wo, f_r, u_f_r=0.01 * f_r, flags=flags, channels=["a", "b"])
    return made.assign_attrs(note="kept")


def test_rejected_and_taken_back(samples, tmp_path):
    """Catches a flag that stays, a log that shrinks, and any other bit of the file that changes."""
    path = tmp_path / "samples.nc"
    write(samples, path)
    before = read(path)
    write(reject(before, np.array([3, 7, 8]), selection="3,7-8", **WHO), path)
    write(reject(read(path), np.array([8, 20]), channels=[1], **WHO), path)
    rejected = read(path)
    flags = rejected["flags"].to_numpy()
    assert set(np.flatnonzero((flags & REJECTED).any(axis=1))) == {3, 7, 8, 20}
    assert flags[20].tolist() == [0, REJECTED]
    assert flags[7].tolist() == [4 | REJECTED] * 2
    write(restore(rejected, 1, **WHO), path)
    half = read(path)
    assert set(np.flatnonzero((half["flags"].to_numpy() & REJECTED).any(axis=1))) == {8, 20}
    assert [entry.number for entry in standing(half)] == [2]
    write(restore(half, 2, reason="", author="Bo", date=WHEN), path)
    after = read(path)
    assert after.drop_vars("rejection_log").identical(before)
    log = log_of(after)
    assert [(entry.number, entry.action, entry.of) for entry in log] == [
        (1, "reject", 0),
        (2, "reject", 0),
        (3, "restore", 1),
        (4, "restore", 2),
    ]
    assert log[0].samples == "3,7-8"
    assert log[0].date == "2026-05-04T03:02:01+00:00"
    assert (log[0].author, log[0].reason) == ("Ada", "stray light")
    with pytest.raises(BadInput, match="no rejection 1 stands"):
        restore(after, 1, **WHO)


def test_a_fit_leaves_them_out(samples):
    """Catches rejected samples that still pull a fit."""
    spoiled = samples.copy(deep=True)
    spoiled["f_r"][5:10] = 50.0
    clean = samples.isel(sample=[i for i in range(40) if not 5 <= i < 10])
    kept = fit(reject(spoiled, np.arange(5, 10), **WHO), "lambert")
    np.testing.assert_allclose(kept.parameters["kd"], fit(clean, "lambert").parameters["kd"], rtol=1e-9)


def test_chosen(samples):
    """Catches a selection that means other samples than it says, or that passes although it means none."""
    found = {"negatives": np.array([4, 2])}
    assert chosen(samples, ["3,10-12"], found).tolist() == [3, 10, 11, 12]
    assert chosen(samples, ["negatives"], found).tolist() == [2, 4]
    theta_deg = np.degrees(np.arccos(samples["wo"].to_numpy()[:, 2]))
    assert chosen(samples, ["theta_o=70..90"], found).tolist() == np.flatnonzero(theta_deg >= 70).tolist()
    # The light stands at azimuth 180: views at -28 to 28 deg are 152 to 208 deg away.
    boxed = chosen(samples, ["theta_o=0..90", "azimuth=170..180"], found)
    phi_deg = np.degrees(np.linspace(-0.5, 0.5, 40))
    assert boxed.tolist() == np.flatnonzero((phi_deg >= -10.0) & (phi_deg <= 0.0)).tolist()
    for words in (["40"], ["theta_o=1..0"], ["energy"], ["-3"], ["theta_x=1..2"]):
        with pytest.raises(BadInput):
            chosen(samples, words, found)


def test_needs_reason_and_name(samples):
    """Catches an anonymous rejection."""
    for name in ("reason", "author"):
        with pytest.raises(BadInput, match=name):
            reject(samples, np.array([1]), **{**WHO, name: " "})


def test_other_formats_are_refused(samples, tmp_path):
    """Catches a rejection that gets lost in a format without a place for it."""
    write(samples, tmp_path / "samples.csv")
    with pytest.raises(Refused, match=r"convert it to \.nc first"):
        require_store(tmp_path / "samples.csv")
    with pytest.raises(BadInput, match="no such file"):
        require_store(tmp_path / "none.nc")
    write(samples, tmp_path / "samples.nc")
    assert require_store(tmp_path) == tmp_path / "samples.nc"


def test_spans():
    """Catches numbers that the log loses."""
    assert spans(np.array([0, 1, 2, 5, 7, 8])) == "0-2,5,7-8"


def _rejected(samples):
    """Return the numbers of rejected samples."""
    return set(np.flatnonzero((samples["flags"].to_numpy() & REJECTED).any(axis=1)).tolist())


def test_carried_over_in_any_order_of_samples_and_channels(samples):
    """Catches numbers that mean other samples or channels, and a log that forgets what was taken back."""
    old = reject(samples, np.array([3, 7, 8]), selection="3,7-8", **WHO)
    old = reject(old, np.array([8, 20]), channels=[1], **WHO)
    old = restore(old, 1, **WHO)
    order = np.random.default_rng(1).permutation(40)
    new = samples.isel(sample=order, channel=[1, 0])
    new = new.assign(wi=new["wi"] + 5e-10, f_r=2.0 * new["f_r"])
    carried = carry_over(old, new)
    assert {order[number] for number in _rejected(carried)} == {8, 20}
    assert not np.any(carried["flags"].to_numpy()[:, 1] & REJECTED)
    assert carried.drop_vars([LOG, "flags"]).identical(new.drop_vars("flags"))
    np.testing.assert_array_equal(carried["flags"] & ~REJECTED, new["flags"])
    assert carried["flags"].attrs == new["flags"].attrs
    log = log_of(carried)
    assert [entry.number for entry in standing(carried)] == [2]
    assert [(entry.action, entry.author, entry.reason) for entry in log] == [
        (entry.action, entry.author, entry.reason) for entry in log_of(old)
    ]
    assert log[0].samples == spans(np.sort(np.argsort(order)[[3, 7, 8]]))
    assert (log[0].selection, log[1].channels) == ("3,7-8", (0,))
    assert carry_over(carried, old).identical(old)
    assert carry_over(samples, new) is new


def test_not_carried_over(samples):
    """Catches rejections that land on other samples, or vanish, where the new table is another one."""
    old = reject(samples, np.array([3]), channels=[1], **WHO)
    turned = samples.copy(deep=True)
    turned["wo"][3] = turned["wo"].to_numpy()[3] * [1.0, -1.0, 1.0]
    for new, why in (
        (samples.isel(sample=slice(39)), "40 samples became 39"),
        (turned, "rejection 1 by Ada"),
        (samples.isel(channel=[0]), "rejection 1 by Ada"),
        (reject(samples, np.array([4]), **WHO), "both"),
    ):
        with pytest.raises(Refused, match=why):
            carry_over(old, new)
    freed = restore(old, 1, **WHO)
    assert [entry.samples for entry in log_of(carry_over(freed, turned))] == ["", ""]
    assert not _rejected(carry_over(freed, turned))
    assert [entry.action for entry in log_of(carry_over(freed, samples.isel(sample=[0, 3])))] == [
        "reject",
        "restore",
    ]
    elsewhere = reject(samples, np.array([30]), **WHO)
    assert _rejected(carry_over(elsewhere, turned)) == {30}


def test_one_log_may_continue_the_other(samples):
    """Catches entries of either file that vanish where both have them."""
    first = reject(samples, np.array([3]), **WHO)
    second = reject(first, np.array([5]), **WHO)
    assert carry_over(first, second) is second
    assert _rejected(carry_over(second, first)) == {3, 5}
    bare = second.drop_vars(LOG)
    assert _rejected(carry_over(first, bare)) == {3, 5}


def _repeated(poses):
    """Return one direction measured four times, and another once."""
    wi = spherical_to_direction(np.full(5, 0.5), np.pi)
    wo = spherical_to_direction(np.array([0.2, 0.2, 0.2, 0.2, 0.9]), np.zeros(5))
    return make_samples(wi, wo, np.array([0.1, 0.4, 0.2, 0.3, 0.5]), pose=poses)


def test_samples_that_share_directions():
    """Catches a rejection that moves to another repeat of its directions."""
    known, reverse = _repeated(np.arange(5)), np.arange(5)[::-1]
    changed = known.assign(f_r=1.1 * known["f_r"]).isel(sample=reverse)
    old = reject(known, np.array([1]), **WHO)
    assert _rejected(carry_over(old, changed)) == {3}
    # The same numbers of poses are not needed where directions are enough.
    alone = reject(known, np.array([4]), **WHO)
    assert _rejected(carry_over(alone, changed.assign(pose=changed["pose"] + 7))) == {0}
    # Without a pose only the value tells repeats apart, as long as it is the same.
    unknown, anonymous = (table.drop_vars("pose") for table in (known, changed))
    part = reject(unknown, np.array([1, 2]), **WHO)
    assert _rejected(carry_over(part, unknown.isel(sample=reverse))) == {3, 2}
    with pytest.raises(Refused, match="not found again"):
        carry_over(part, anonymous)
    every = reject(unknown, np.arange(4), **WHO)
    assert _rejected(carry_over(every, anonymous)) == {1, 2, 3, 4}


def test_narrowed_samples_keep_the_log_under_their_new_numbers(samples):
    """Catches a log that names samples which narrowing took away or moved."""
    rejected = reject(samples, np.array([1, 8, 39]), channels=[1], **WHO)
    few = select(narrowed(rejected, list(range(5, 40)), [1]), max_theta_deg=60.0)
    assert few.sizes["channel"] == 1
    assert [(entry.samples, entry.channels) for entry in log_of(few)] == [("3", (0,))]
    assert np.flatnonzero(few["flags"].to_numpy()[:, 0] & REJECTED).tolist() == [3]
    again = reject(few, np.array([0]), **WHO)
    assert np.flatnonzero(again["flags"].to_numpy()[:, 0] & REJECTED).tolist() == [0, 3]


def test_joined_files_keep_their_logs(samples, tmp_path):
    """Catches logs that joining drops, and numbers that mean another file's samples or entries."""
    first = restore(reject(samples, np.array([3, 39]), **WHO), 1, **WHO)
    third = reject(reject(samples, np.array([0, 1]), channels=[1], **WHO), np.array([5]), **WHO)
    third = restore(third, 2, **WHO)
    without = reject(samples, np.array([2]), **WHO).drop_vars(LOG)
    together, dropped = join([first, samples, third, without], ["1.nc", "2.nc", "3.nc", "4.nc"])
    assert dropped == ()
    log = log_of(together)
    assert [(entry.number, entry.action, entry.of, entry.samples) for entry in log] == [
        (1, "reject", 0, "3,39"),
        (2, "restore", 1, ""),
        (3, "reject", 0, "80-81"),
        (4, "reject", 0, "85"),
        (5, "restore", 4, ""),
    ]
    assert _rejected(together) == {80, 81, 122}
    assert not together["flags"].to_numpy()[[80, 81], 0].any()
    assert [entry.number for entry in standing(together)] == [3]
    write(together, tmp_path / "all.nc")
    again = reject(read(tmp_path / "all.nc"), np.array([0]), **WHO)
    assert log_of(again)[-1].number == 6
    assert _rejected(again) >= {0, 80, 81}
