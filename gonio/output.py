"""What a person or a script sees: results on standard output, everything else on standard error."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Mapping


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add `--json` to a command: one JSON object on standard output and nothing else there."""
    parser.add_argument("--json", action="store_true", help="print one JSON object, for scripts")


def print_json(result: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; numpy values become lists and numbers, NaN becomes null."""
    print(json.dumps(_plain(result)), flush=True)


def say(text: str, *, end: str = "\n") -> None:
    """Tell a person something on standard error; work goes on where nobody reads it any more."""
    with contextlib.suppress(OSError, ValueError):  # the terminal was closed, the pipe's reader left
        print(text, end=end, file=sys.stderr, flush=True)


def caution(file: str, attributes: Mapping[Any, Any]) -> str:
    """Tell a person why a file may have been cut short or damaged, where its reader saw signs of it.

    Parameters
    ----------
    file : str
        Its name.
    attributes : mapping
        Of the samples that were read.

    Returns
    -------
    str
        The doubts, for the JSON object; empty where there are none.
    """
    from analysis.formats.doubts import ATTRIBUTE

    doubts = str(attributes.get(ATTRIBUTE, ""))
    if doubts:
        say(f"caution: {file}: {doubts}")
    return doubts


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int | bool):
        return value
    return str(value)


@contextlib.contextmanager
def at_work(what: str, *, after_s: float = 2.0, every_s: float = 5.0) -> Iterator[None]:
    """Say on standard error that work whose end nobody knows goes on, once it takes longer than `after_s`."""
    begin, done = time.monotonic(), threading.Event()

    def tell() -> None:
        wait = after_s
        while not done.wait(wait):
            say(f"{what}  {time.monotonic() - begin:.0f} s")
            wait = every_s

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()


class Progress:
    """A one-line progress display on standard error: a bar on a terminal, a line every few seconds elsewhere.

    Parameters
    ----------
    label : str
        What is being done.
    total : int
        How many steps there are.
    """

    LINE_INTERVAL_S = 5.0
    BAR_INTERVAL_S = 0.1

    def __init__(self, label: str, total: int) -> None:
        self._label, self._total, self._done = label, max(total, 1), 0
        self._start = time.monotonic()
        self._terminal = sys.stderr.isatty()
        self._last = self._start if not self._terminal else 0.0

    def __call__(self, step: int = 1, note: str = "") -> None:
        """Advance by `step` and redraw when it is time to."""
        self._done += step
        now = time.monotonic()
        interval = self.BAR_INTERVAL_S if self._terminal else self.LINE_INTERVAL_S
        if now - self._last < interval and self._done < self._total:
            return
        self._last = now
        elapsed = now - self._start
        left = elapsed / self._done * max(self._total - self._done, 0) if self._done else math.nan
        text = f"{self._label} {self._done}/{self._total}  {elapsed:.0f} s, about {left:.0f} s left  {note}"
        end = "\n" if not self._terminal or self._done >= self._total else ""
        start = "\r\x1b[K" if self._terminal else ""
        say(f"{start}{text.rstrip()}", end=end)
