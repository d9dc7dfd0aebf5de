"""Bluesky's engine as a capture uses it, and its documents on disk."""

from __future__ import annotations

import json
import logging
from typing import TYPE_CHECKING, Any

from bluesky import RunEngine
from bluesky.utils import DuringTask

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable
    from pathlib import Path
    from types import TracebackType

# The engine logs every failed plan with its traceback; what a person needs to know is in our own one line.
logging.getLogger("bluesky").addHandler(logging.NullHandler())


class DocumentLog:
    """Appends documents to a file, one JSON array [name, document] a line.

    They are metadata: what must not be lost is in the journal.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("a", encoding="utf-8")

    def __enter__(self) -> DocumentLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def __call__(self, name: str, document: dict[str, Any]) -> None:
        """Append one document."""
        print(json.dumps([name, document], default=str), file=self._file, flush=True)


class SafeWait(DuringTask):
    """How the main thread waits for the engine.

    On a Ctrl-C that nobody handles the engine itself would throw an exception into its own thread, anywhere
    in a plan. Here the machine is stopped instead, which fails what the plan waits for, which ends the plan.

    Parameters
    ----------
    stop : callable
        Stops the machine.
    """

    def __init__(self, stop: Callable[[], object]) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._stop = stop
        self.interrupted = False
        """Whether a Ctrl-C came."""

    def block(self, blocking_event: threading.Event) -> None:
        """Wait until the plan has ended."""
        while not blocking_event.is_set():
            try:
                blocking_event.wait()
            except KeyboardInterrupt:
                self.interrupted = True
                self._stop()


def make_engine(log: DocumentLog, wait: SafeWait) -> RunEngine:
    """Make an engine that leaves signals alone: gonio's own handlers decide what Ctrl-C does.

    Parameters
    ----------
    log : DocumentLog
        Where its documents go.
    wait : SafeWait
        How the main thread waits for it.
    """
    engine = RunEngine({}, context_managers=[], during_task=wait)
    engine.subscribe(log)  # type: ignore[no-untyped-call]
    return engine
