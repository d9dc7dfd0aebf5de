"""A capture that dies by SIGKILL at any step that leaves a trace: run as a process of its own, told by lines.

Each request, a line of JSON, is carried out in a fork: capture or resume, counting every step, dead at the
one asked for. A step is, before and after, every statement on the journal, every change of names or fsync of
files, every move and every shot; nobody lists them, so that a step added later is counted too. A step is
named after the function of gonio that takes it, such as `journal.intend: COMMIT, after`.
"""

from __future__ import annotations

import functools
import itertools
import json
import os
import signal
import sqlite3
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

FILE_STEPS = ("fsync", "mkdir", "rename", "replace", "rmdir", "unlink")
ROOMS = tuple(Path(__file__).parents[2] / room for room in ("capture", "rig"))
WRAPPERS = {"_change", "write_durably", "sync_file", "sync_folder"}
"""Helpers: a step is named after who calls them."""


class Steps:
    """Counts steps into a file, and dies at one.

    Parameters
    ----------
    path : Path
        Gets a line a step, at once.
    last : int or None
        Where to die; None lives.
    """

    def __init__(self, path: Path, last: int | None) -> None:
        self._file = os.open(path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        self._last, self._count = last, itertools.count()

    def at(self, what: str) -> None:
        """Be at a step; perhaps the last."""
        os.write(self._file, f"{_taker(sys._getframe(1))}: {what}\n".encode())
        if next(self._count) == self._last:
            os.kill(os.getpid(), signal.SIGKILL)

    def around(self, what: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Count a step before and one after a function."""

        @functools.wraps(function)
        def stepped(*args: Any, **options: Any) -> Any:
            self.at(f"{what}, before")
            result = function(*args, **options)
            self.at(f"{what}, after")
            return result

        return stepped


def _taker(frame: FrameType | None) -> str:
    """Name the function of gonio that takes a step."""
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if path.parent in ROOMS and frame.f_code.co_name not in WRAPPERS:
            return f"{path.stem}.{frame.f_code.co_name}"
        frame = frame.f_back
    return "other"


def _watch(steps: Steps) -> None:
    """Make everything that leaves a trace a step."""
    from rig.machine import Machine

    class Connection(sqlite3.Connection):
        def _step(self, name: str, statement: str, *values: Any) -> Any:
            run = getattr(sqlite3.Connection, name)
            verb = statement.split(maxsplit=1)[0]
            if verb in {"SELECT", "PRAGMA"}:
                return run(self, statement, *values)
            return steps.around(verb, run)(self, statement, *values)

        def execute(self, statement: str, *values: Any) -> Any:  # type: ignore[override]
            return self._step("execute", statement, *values)

        def executemany(self, statement: str, *values: Any) -> Any:  # type: ignore[override]
            return self._step("executemany", statement, *values)

        def executescript(self, statement: str) -> Any:  # type: ignore[override]
            return self._step("executescript", statement)

    sqlite3.connect = functools.partial(sqlite3.connect, factory=Connection)  # type: ignore[assignment]
    for name in FILE_STEPS:
        setattr(os, name, steps.around(name, getattr(os, name)))
    for name in ("move", "shoot"):
        setattr(Machine, name, steps.around(name, getattr(Machine, name)))


def _carry_out(request: dict[str, Any]) -> int:
    from capture.plan import plan_from
    from capture.run import capture, resume

    _watch(Steps(Path(request["steps"]), request["last"]))
    session = Path(request["session"])
    if session.exists():
        return 0 if resume(session).complete else 3
    return 0 if capture(plan_from(request["plan"], "test"), request["rig"], session).complete else 3


def main() -> None:
    """Carry out requests until there are no more."""
    import capture.run  # noqa: F401 - imported once, for all forks

    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            code = 1
            try:
                code = _carry_out(json.loads(line))
            except Exception:  # noqa: BLE001 - the test shows it, and the exit code
                traceback.print_exc()
            finally:
                os._exit(code)
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
