"""The error tree: one class per policy, one line per message.

A message always says what happened, where, and what to do next, so that the front door can print it as it is
and a person at the rig at three in the morning knows the next step.
"""

from __future__ import annotations


class GonioError(Exception):
    """Base of every error that gonio raises on purpose.

    Parameters
    ----------
    what : str
        What happened.
    where : str, optional
        The file, port, servo, pose or field concerned.
    todo : str, optional
        What the person should do next.
    """

    exit_code = 2

    def __init__(self, what: str, *, where: str = "", todo: str = "") -> None:
        self.what, self.where, self.todo = what, where, todo
        head = f"{where}: {what}" if where else what
        super().__init__(f"{head}; {todo}" if todo else head)


class BadInput(GonioError):  # noqa: N818 - the tree's names are policies, not suffixes
    """A file, an option or a value from outside that cannot be used."""

    exit_code = 2


class Refused(GonioError):  # noqa: N818
    """The program or a device declines: asking again changes nothing until a person changes something."""

    exit_code = 3


class Transient(GonioError):  # noqa: N818
    """A fault that a retry may cure: a corrupt packet, a late reply, a late file."""

    exit_code = 4


class DeviceLost(GonioError):  # noqa: N818
    """A device that no longer answers: unplugged, unpowered, or not there."""

    exit_code = 4


class Unsafe(GonioError):  # noqa: N818
    """Going on could damage something or somebody: the program has stopped light and arms."""

    exit_code = 5
