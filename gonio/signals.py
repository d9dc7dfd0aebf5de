"""Ctrl-C, SIGTERM and a dead parent while a machine runs: finish the frame, abort, stop.

The first Ctrl-C asks to finish what is under way, the second aborts at once. SIGTERM stops at once, and so
does the end of the program that started this one (a closed terminal, a killed script): nobody is there to see
what happens. Whoever wants it to go on all the same says so as everywhere, with `nohup`.

A handler itself only notes what came; a thread that waited from the beginning does the stopping, because a
handler interrupts the main thread anywhere, also while it holds the very lock that stopping needs.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import sys
import threading
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType, TracebackType

EXIT_CTRL_C, EXIT_SIGTERM = 130, 143

PARENT_S = 0.2
"""How often the parent is looked for."""

JOIN_S = 30.0
"""How long leaving waits for a stop under way: as long as a stop with dead servos takes at worst."""


class StopRequests:
    """Turns signals into requests, as a context manager in the main thread.

    Parameters
    ----------
    label : str
        What the person is told is being finished, such as "frame".
    patient : bool
        Whether a first Ctrl-C lets it finish; otherwise it aborts like a second.

    Examples
    --------
    >>> with StopRequests("frame") as requests:  # doctest: +SKIP
    ...     with open_machine(rig, inspect=inspect_frame) as machine:
    ...         requests.on_abort(machine.stop)
    ...         for pose in poses:
    ...             machine.move(pose)
    ...             if requests.finish_requested:
    ...                 break
    ... return requests.exit_code or 0
    """

    def __init__(self, label: str = "frame", *, patient: bool = True) -> None:
        self._label, self._patient = label, patient
        self._finish = self._abort = False
        self._exit_code: int | None = None
        self._callbacks: list[Callable[[], object]] = []
        self._callbacks_lock = threading.Lock()  # never taken by a handler
        self._previous: dict[int, Any] = {}
        self._notes: queue.SimpleQueue[str | None] = queue.SimpleQueue()  # its put() may interrupt itself
        self._thread = threading.Thread(target=self._serve, name="signals", daemon=True)
        self._left = threading.Event()

    def __enter__(self) -> StopRequests:
        self._thread.start()
        handled = {"SIGINT": self._interrupt, "SIGTERM": self._terminate, "SIGBREAK": self._terminate}
        hang_up = getattr(signal, "SIGHUP", None)
        outlives = hang_up is not None and signal.getsignal(hang_up) is signal.SIG_IGN  # by nohup
        if not outlives:
            handled["SIGHUP"] = self._terminate
            threading.Thread(target=self._watch_parent, args=(os.getppid(),), daemon=True).start()
        for name, handler in handled.items():
            number = getattr(signal, name, None)  # not every system has all of them
            if number is not None:
                self._previous[number] = signal.signal(number, handler)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._left.set()
        self._notes.put(None)
        self._thread.join(JOIN_S)
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    @property
    def finish_requested(self) -> bool:
        """Whether to end after the frame under way."""
        return self._finish

    @property
    def abort_requested(self) -> bool:
        """Whether to end now; the abort callbacks have been called, or are being."""
        return self._abort

    @property
    def exit_code(self) -> int | None:
        """130 after Ctrl-C, 143 after SIGTERM or the parent's end, None if nothing came."""
        return self._exit_code

    def on_abort(self, callback: Callable[[], object]) -> None:
        """Register what stops the machine at once; another thread calls it, now if the abort came already."""
        with self._callbacks_lock:
            self._callbacks.append(callback)
        if self._abort:
            self._notes.put("")

    def _interrupt(self, _number: int, _frame: FrameType | None) -> None:
        if self._exit_code is None:
            self._exit_code = EXIT_CTRL_C
        if self._patient and not self._finish:
            self._finish = True
            self._notes.put(f"finishing the {self._label}; Ctrl-C again aborts at once")
        else:
            self._finish = self._abort = True
            self._notes.put("aborting: light off, arms stopped")

    def _terminate(self, _number: int, _frame: FrameType | None) -> None:
        self._stop_now("terminated")

    def _watch_parent(self, parent: int) -> None:
        """Stop when the system has given this program another parent: its own is gone."""
        while not self._left.wait(PARENT_S):
            if os.getppid() != parent:
                self._stop_now("the program that started this one is gone")
                return

    def _stop_now(self, why: str) -> None:
        self._exit_code = EXIT_SIGTERM
        self._finish = self._abort = True
        self._notes.put(f"{why}: light off, arms stopped")

    def _serve(self) -> None:
        while (note := self._notes.get()) is not None:
            if note:
                with contextlib.suppress(OSError, ValueError):  # nobody may be reading any more
                    print(f"gonio: {note}", file=sys.stderr, flush=True)
            if self._abort:
                with self._callbacks_lock:
                    callbacks, self._callbacks = self._callbacks, []
                for callback in callbacks:
                    callback()
