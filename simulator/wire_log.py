"""What went over the wires and what the light did, as lines of JSON with monotonic times."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path


class WireLog:
    """The log file.

    Parameters
    ----------
    path : Path or None
        Where to write, replacing what is there; None to keep no log.
    """

    def __init__(self, path: Path | None) -> None:
        self._file = path.open("w", encoding="ascii", buffering=1 << 16) if path else None
        self.dirty = False

    def wire(self, line: str, direction: str, data: bytes, now: float) -> None:
        """Note bytes on a wire; `direction` is "in" (from the client) or "out"."""
        if self._file and data:
            self._file.write(
                f'{{"t":{now:.6f},"line":"{line}","direction":"{direction}","data":"{data.hex()}"}}\n'
            )
            self.dirty = True

    def event(self, event: str, now: float, details: dict[str, Any]) -> None:
        """Note that something happened to light, shutter or arms."""
        if self._file:
            self._file.write(
                json.dumps({"t": round(now, 6), "line": "state", "event": event, **details}) + "\n"
            )
            self.dirty = True

    def flush(self) -> None:
        """Hand everything to the operating system, so that a reader sees it."""
        if self._file:
            self._file.flush()
            self.dirty = False

    def close(self) -> None:
        """Write the rest and close the file."""
        if self._file:
            self._file.close()
