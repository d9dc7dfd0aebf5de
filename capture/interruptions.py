"""What a journal tells of everything that did not go straight: poses that are missing, and interruptions."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from capture.journal import Journal
    from capture.records import Role

SKIPPED = "skipped"
"""Kind of the event of a pose that could not be had."""

REFERENCE = "reference"
"""Kind of the event of a comparison with a reference pose."""

INTERRUPTIONS = {
    "retry": "shots made again",
    SKIPPED: "poses skipped",
    "paused": "pauses",
    "moved": "poses shot anew from elsewhere",
    "withdrawn": "frames lost",
    "interrupted": "stopped by a person",
    "incomplete": "ended with poses missing",
    "failed": "ended by a fault",
    "resumed": "resumed",
}
"""Kinds of event of which a person who judges the data should know, and in words what their count counts."""


@dataclass(frozen=True, slots=True)
class Hole:
    """A visit that was tried and could not be had.

    Attributes
    ----------
    role : Role
    pose : int
    times : int
        How often it was skipped.
    reason : str
        Of the last time.
    """

    role: Role
    pose: int
    times: int
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self) | {"role": self.role.value}


def holes(journal: Journal) -> tuple[Hole, ...]:
    """List the visits that were skipped and are still not done, in the session's order."""
    skips: dict[int, list[str]] = {}
    for event in journal.events():
        if event.kind == SKIPPED:
            skips.setdefault(event.detail["visit"], []).append(event.detail["error"])
    return tuple(
        Hole(visit.role, visit.pose, len(skips[visit.number]), skips[visit.number][-1])
        for visit in journal.visits()
        if not visit.done and visit.number in skips
    )


def interruptions(journal: Journal) -> dict[str, int]:
    """Count what interrupted a session, by kind of event; what never happened is left out."""
    counts = Counter(event.kind for event in journal.events())
    return {kind: counts[kind] for kind in INTERRUPTIONS if counts[kind]}
