"""What a capture does about a fault, as a table: class, examples, tries, and what then.

The table of `docs/faults.md` is this one. The classes are those of `rig.errors`: a device says which kind of
fault it met, and nothing else decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from rig.errors import BadInput, DeviceLost, GonioError, Refused, Transient, Unsafe


class Then(Enum):
    """What follows a fault that stays."""

    SKIP = "the pose is skipped with its reason, and tried again at the end of its pass"
    STOP = "light off, every arm stopped, the run ends"
    END = "nothing is done that was not asked for; light off, every arm stopped, the run ends"


@dataclass(frozen=True, slots=True)
class Rule:
    """What is done about one class of fault.

    Attributes
    ----------
    kind : type of GonioError
    name : str
        In words.
    examples : str
    tries : int
        How often a shot is made before the fault counts as one that stays.
    then : Then
    """

    kind: type[GonioError]
    name: str
    examples: str
    tries: int
    then: Then


POLICY: tuple[Rule, ...] = (
    Rule(
        Transient,
        "passing",
        "a packet lost or damaged, a late reply, a file that is not the picture, an exposure cut short, "
        "light beyond `lamp.monitor_band`",
        3,
        Then.SKIP,
    ),
    Rule(
        DeviceLost,
        "lost",
        "port gone, servo silent, no file within `camera.file_timeout_s`, lamp controller restarted",
        1,
        Then.STOP,
    ),
    Rule(
        Unsafe,
        "unsafe",
        "an arm that stalls, leaves its place or the way that was checked, or reports an error, "
        "an open door, light that stays on, a level that does not settle",
        1,
        Then.STOP,
    ),
    Rule(
        Refused,
        "refused",
        "another camera's frame, a changed plan, rig or calibration, a reference pose that has changed, "
        "a full disk",
        1,
        Then.END,
    ),
    Rule(
        BadInput,
        "unusable",
        "a plan, rig file or session that cannot be read, or says what is not possible",
        1,
        Then.END,
    ),
)

MOST_SKIPS_IN_A_ROW = 2
"""One more pose in a row that cannot be had, and the machine is taken for broken: the run stops safely."""


def rule_for(error: BaseException) -> Rule | None:
    """Find what is done about an error; None for one that is no device's fault but gonio's own."""
    return next((rule for rule in POLICY if isinstance(error, rule.kind)), None)


class Patience:
    """Counts poses in a row that could not be had: a broken machine is not hammered all night.

    Parameters
    ----------
    most : int
        How many may be skipped in a row.
    """

    def __init__(self, most: int = MOST_SKIPS_IN_A_ROW) -> None:
        self._most, self._lost = most, 0

    def may_skip(self, error: BaseException) -> bool:
        """Whether the pose at which an error stayed may be skipped; a yes counts as one lost."""
        rule = rule_for(error)
        if rule is None or rule.then is not Then.SKIP or self._lost >= self._most:
            return False
        self._lost += 1
        return True

    def regain(self) -> None:
        """Begin anew: a pose has been had."""
        self._lost = 0
