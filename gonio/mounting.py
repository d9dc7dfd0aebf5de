"""Asking a person to mount the white or a sample, on machines without a wheel."""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING

from gonio.output import Progress, say
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse
    from collections.abc import Collection

    from capture.wishes import Wishes
    from gonio.signals import StopRequests

POLL_S = 0.1
"""How often a question looks whether Ctrl-C has answered it."""


def add_mounted_option(parser: argparse.ArgumentParser, roles: Collection[str]) -> None:
    """Add the option that answers questions ahead."""
    parser.add_argument(
        "--mounted",
        default="",
        metavar=",".join(roles),
        help="on a machine without a wheel: what need not be asked for",
    )


def mounted_roles(text: str, roles: Collection[str]) -> frozenset[str]:
    """Read what is mounted already.

    Raises
    ------
    BadInput
        A word that is none of the roles.
    """
    named = frozenset(part.strip() for part in text.split(",") if part.strip())
    unknown = sorted(named - set(roles))
    if unknown:
        todo = f"name {', '.join(roles)}"
        raise BadInput(f"nothing is called {unknown[0]!r}", where="--mounted", todo=todo)
    return named


def machine_wishes(requests: StopRequests, mounted: frozenset[str], command: str) -> Wishes:
    """Give what a run on the machine asks of a person at a terminal: progress, questions, Ctrl-C."""
    from capture.wishes import Wishes

    bar: list[Progress] = []

    def progress(done: int, total: int, note: str) -> None:
        if not bar:
            bar.append(Progress(command, total - done + 1))
        bar[0](1, note)

    return Wishes(
        controls=requests,
        mount=(lambda _role, label: ask(requests, label)) if sys.stdin.isatty() else None,
        mounted=mounted,
        progress=progress,
        say=lambda line: say(f"gonio {command}: {line}"),
    )


def ask(requests: StopRequests, label: str) -> bool:
    """Ask a person to mount something; False where he presses Ctrl-C or closes the input instead.

    A thread reads the line, because reading it here would keep Ctrl-C waiting for the Enter key.
    """
    say(f"Mount {label}, then press Enter (Ctrl-C to stop here): ", end="")
    answer: list[str] = []
    reader = threading.Thread(target=lambda: answer.append(sys.stdin.readline()), daemon=True)
    reader.start()
    while reader.is_alive() and not requests.finish_requested:
        reader.join(POLL_S)
    return bool(answer and answer[0]) and not requests.finish_requested
