"""Bluesky's engine as a capture uses it, and its documents on disk."""

from __future__ import annotations

import json
import logging
from typing import TYPE_CHECKING, Any

from bluesky import RunEngine

if TYPE_CHECKING:
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


def make_engine(log: DocumentLog) -> RunEngine:
    """Make an engine that leaves signals alone: gonio's own handlers decide what Ctrl-C does.

    Parameters
    ----------
    log : DocumentLog
        Where its documents go.
    """
    engine = RunEngine({}, context_managers=[])
    engine.subscribe(log)  # type: ignore[no-untyped-call]
    return engine
