"""Rejected samples: flagged, logged, taken back; nothing else of the file changes, fits leave them out."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from analysis.fit import fit
from analysis.rejection import REJECTED, chosen, log_of, reject, require_store, restore, spans, standing
from analysis.samples import make_samples, read, write
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
