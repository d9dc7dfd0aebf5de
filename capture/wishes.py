"""What a capture asks of whoever started it, and what it tells him."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from capture.interruptions import Hole
    from rig.stop_report import StopReport


class Controls(Protocol):
    """How a person ends a capture early; `gonio.signals.StopRequests` is one."""

    @property
    def finish_requested(self) -> bool:
        """Whether to end after the frame under way."""

    @property
    def abort_requested(self) -> bool:
        """Whether the machine has been stopped on request."""

    def on_abort(self, callback: Callable[[], object]) -> None:
        """Register what stops the machine at once."""


class NoControls:
    """Nobody ends the capture early."""

    finish_requested = False
    abort_requested = False

    def on_abort(self, callback: Callable[[], object]) -> None:
        """Nobody calls."""


@dataclass(frozen=True)
class Wishes:
    """What a capture asks of whoever started it.

    Attributes
    ----------
    controls : Controls
        Who may end it early.
    mount : callable
        (role, label) -> whether the person has mounted it; asked on machines without a wheel before each
        pass, with the light off and the arms parked.
    mounted : collection of str
        Roles that need not be asked for.
    progress : callable
        (visits done, of how many, note) after each visit.
    say : callable
        Told in one line what a person should know.
    """

    controls: Controls = field(default_factory=NoControls)
    mount: Callable[[str, str], bool] | None = None
    mounted: Collection[str] = ()
    progress: Callable[[int, int, str], None] = lambda _done, _total, _note: None
    say: Callable[[str], None] = lambda _line: None


@dataclass(frozen=True, slots=True)
class CaptureResult:
    """How a capture ended.

    Attributes
    ----------
    session : Path
    complete : bool
        Whether everything planned is recorded; otherwise it was interrupted and can be resumed.
    poses : int
        Poses of the sample that count.
    frames : int
        Verified frames, darks included.
    refused : int
        Poses that the machine cannot take.
    flagged : int
        Poses with a flag.
    seconds : float
        Of this run.
    stop : StopReport or None
        How light and arms took the stop at the end.
    holes : tuple of Hole
        Poses that were tried and could not be had.
    """

    session: Path
    complete: bool
    poses: int
    frames: int
    refused: int
    flagged: int
    seconds: float
    stop: StopReport | None
    holes: tuple[Hole, ...] = ()
