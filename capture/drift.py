"""When a reference has to be shot: when the drift since the last predicts an error beyond what is allowed.

What the lamp's photodiode reads is taken out of the samples; what it does not read is not. So the error that
may have come up since the last reference is put together, in quadrature, from

- a share of the drift that the photodiode has read: it looks at the lamp, not at the sample. The share begins
  with `UNSEEN_SHARE` and is whatever references have shown where that is more;
- the lamp head's temperature, `PER_KELVIN` for each kelvin: colour of the lamp, response of the sensor;
- the time, at the fastest rate at which a reference has been found to be off.

A machine that stands still is asked rarely, by time alone; one that drifts is asked as often as it must.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

from capture.interruptions import REFERENCE
from capture.records import Role

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.journal import Journal
    from capture.plan import References
    from capture.records import Event

UNSEEN_SHARE = 0.1
"""Part of the drift read that is taken to be unseen, until references show more."""

PER_KELVIN = 2e-4
"""Relative change of what is measured for each kelvin of the lamp head: the order of what silicon sensors
show at the red end, and white light-emitting diodes in their colour."""

COVERAGE = 3.0
"""Standard uncertainties that a reference may be off without telling anything."""


@dataclass(frozen=True, slots=True)
class Moment:
    """State of the light at one time.

    Attributes
    ----------
    time_s : float
        Since the epoch.
    lamp_output : float
        By the photodiode; NaN where it was not read.
    lamp_deg_c : float
        Of the lamp's head; NaN where it was not read.
    """

    time_s: float
    lamp_output: float
    lamp_deg_c: float


@dataclass(frozen=True, slots=True)
class Lessons:
    """What references have told so far.

    Attributes
    ----------
    unseen_share : float
        Part of a drift that the photodiode does not see.
    rate_per_s : float
        Of what is off without a drift that it sees.
    """

    unseen_share: float = UNSEEN_SHARE
    rate_per_s: float = 0.0

    @classmethod
    def of(cls, events: Sequence[Event]) -> Lessons:
        """Learn from all comparisons of a session that were accepted."""
        share, rate = UNSEEN_SHARE, 0.0
        for event in events:
            detail = event.detail
            if event.kind != REFERENCE or not detail.get("accepted"):
                continue
            off = _certainly_off(detail)
            drift = abs(math.log(detail.get("lamp_ratio", 1.0)))
            if drift * UNSEEN_SHARE >= off:
                continue  # as expected
            if off <= drift:
                share = max(share, off / drift)
            elif detail.get("since_s"):
                rate = max(rate, off / detail["since_s"])
        return cls(share, rate)


def _certainly_off(detail: dict[str, Any]) -> float:
    """Share by which the worst channel of a comparison is off beyond its noise."""
    rows = zip(detail.get("ratio", ()), detail.get("u_ratio", ()), strict=True)
    return max((max(abs(ratio - 1.0) - COVERAGE * u, 0.0) for ratio, u in rows), default=0.0)


def unseen_drift(events: Sequence[Event]) -> float:
    """Relative standard uncertainty by drift that references have found and the photodiode has not seen.

    The largest change beyond noise lies somewhere between none and all of it for any one pose: the standard
    deviation of an even distribution from -a to a is a / sqrt(3) (GUM, JCGM 100:2008, 4.3.7). What was
    refused counts too, where a person had the session go on.
    """
    lit = [event.detail for event in events if event.kind == REFERENCE and event.detail["role"] != Role.DARK]
    return max(map(_certainly_off, lit), default=0.0) / math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class Prediction:
    """What may be wrong since the last reference.

    Attributes
    ----------
    since_s : float
        Time since then.
    lamp, temperature, time : float
        Relative errors by the lamp's drift, by its temperature, by time.
    """

    since_s: float
    lamp: float
    temperature: float
    time: float

    @property
    def error(self) -> float:
        """All of them together."""
        return math.hypot(self.lamp, self.temperature, self.time)

    def why(self, asked: References) -> str | None:
        """Say why a reference is due; None where none is."""
        if self.error > asked.tolerance:
            parts = {"the lamp's drift": self.lamp, "its temperature": self.temperature, "time": self.time}
            largest = max(parts, key=lambda name: parts[name])
            return f"{largest} may be {self.error:.2%} since the last, {asked.tolerance:.2%} is allowed"
        if 0.0 < asked.max_interval_s <= self.since_s:
            return f"{self.since_s:.0f} s since the last"
        return None


def predict(last: Moment, now: Moment, lessons: Lessons) -> Prediction:
    """Predict the error that has come up since the last reference; what was not read predicts nothing."""
    drift = abs(math.log(now.lamp_output / last.lamp_output))
    warming = abs(now.lamp_deg_c - last.lamp_deg_c)
    since_s = max(now.time_s - last.time_s, 0.0)
    return Prediction(
        since_s=since_s,
        lamp=lessons.unseen_share * drift if math.isfinite(drift) else 0.0,
        temperature=PER_KELVIN * warming if math.isfinite(warming) else 0.0,
        time=lessons.rate_per_s * since_s,
    )


class DriftWatch:
    """Knows when the next reference is due, from the journal: a resumed session knows as much.

    Parameters
    ----------
    asked : References
        Of the plan.
    journal : Journal
    """

    def __init__(self, asked: References, journal: Journal) -> None:
        self.asked, self._journal = asked, journal
        self._last = _first_moment(journal)
        self._now = self._last
        self._lessons = Lessons()
        self.learn()

    def learn(self) -> None:
        """Take the last reference for the new beginning, and its lesson."""
        events = self._journal.events()
        self._lessons = Lessons.of(events)
        told = [event for event in events if event.kind == REFERENCE and event.detail.get("accepted")]
        if told:
            outputs = [event.detail.get("lamp_output") for event in told]
            self._last = Moment(
                seconds_of(told[-1].time),
                next((output for output in reversed(outputs) if output is not None), math.nan),
                _number(told[-1].detail.get("lamp_deg_c")),
            )
            self._now = self._now or self._last

    def due(self, now: Moment) -> tuple[str, Prediction] | None:
        """Say why a reference is due now, and what is predicted; None where none is.

        Parameters
        ----------
        now : Moment
            An output that is NaN, as after a dark, leaves the last one.
        """
        if self._now is not None and not now.lamp_output > 0.0:
            now = replace(now, lamp_output=self._now.lamp_output)
        self._now = now
        if self._last is None:
            self._last = now
        elif not self._last.lamp_output > 0.0:
            self._last = replace(self._last, lamp_output=now.lamp_output)
        prediction = predict(self._last, now, self._lessons)
        why = prediction.why(self.asked)
        return None if why is None else (why, prediction)


def seconds_of(time: str) -> float:
    """Seconds since the epoch of a journal's time."""
    return datetime.fromisoformat(time).timestamp()


def _first_moment(journal: Journal) -> Moment | None:
    """First light of the session; None before it."""
    for row in journal.levels():
        if row.lamp_output is not None:
            return Moment(seconds_of(row.time), row.lamp_output, _number(row.lamp_deg_c))
    return None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
