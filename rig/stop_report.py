"""What a stop achieved: confirmed, refused by somebody, or unknown because nobody answered."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any


class StopOutcome(Enum):
    """The three honest answers to a stop, best first."""

    CONFIRMED = "confirmed"
    REFUSED = "refused"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class PartStop:
    """How one part of the machine took the stop.

    Attributes
    ----------
    part : str
        "lamp", or a servo with its joint's name.
    outcome : StopOutcome
        Confirmed only by what was read back.
    detail : str
        What was read back, or why not.
    """

    part: str
    outcome: StopOutcome
    detail: str


@dataclass(frozen=True, slots=True)
class StopReport:
    """How the machine took the stop, part by part."""

    parts: tuple[PartStop, ...]

    @property
    def outcome(self) -> StopOutcome:
        """The worst of the parts: unknown before refused before confirmed; unknown when there is no part."""
        return self.worst.outcome if self.parts else StopOutcome.UNKNOWN

    @property
    def worst(self) -> PartStop:
        """The part that decides, the first where several do."""
        return max(self.parts, key=lambda part: list(StopOutcome).index(part.outcome))

    @property
    def details(self) -> tuple[str, ...]:
        """One line per part."""
        return tuple(f"{part.part}: {part.outcome.value} ({part.detail})" for part in self.parts)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        parts = [{"part": p.part, "outcome": p.outcome.value, "detail": p.detail} for p in self.parts]
        return {"outcome": self.outcome.value, "parts": parts}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> StopReport:
        """Inverse of `as_dict`.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the content is no stop report.
        """
        return cls(
            tuple(
                PartStop(str(part["part"]), StopOutcome(part["outcome"]), str(part["detail"]))
                for part in content["parts"]
            )
        )
