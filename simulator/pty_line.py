"""A serial line on a pseudo-terminal that outlives its clients.

What a client leaves behind when it goes, killed or not, would stop the next one: an exclusive lock (TIOCEXCL
stays on a pseudo-terminal as long as its master lives), a line discipline that echoes, bytes that nobody
read. So when the last client has gone, which the master sees as a hang-up, the line is brought back to new.
Only root can reopen a terminal that is locked; anybody else's line gets a fresh one, and the symbolic link
that clients open moves on.

The master is watched edge-triggered: while no client is there, the hang-up is reported once and not for ever.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
import tty
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_EVENTS = select.EPOLLIN | select.EPOLLHUP | select.EPOLLET
_CHUNK = 4096
_FOR_EVERYBODY = 0o666


class PtyLine:
    """One end of a serial line; clients open the other one under the name of a symbolic link.

    Parameters
    ----------
    link : Path
        The symbolic link, replaced if it exists.
    poller : select.epoll
        Where the line registers its descriptor.

    Attributes
    ----------
    fd : int
        The descriptor that the poller reports; another one after the line had to take a fresh terminal, -1
        while it is unplugged.
    """

    fd: int

    def __init__(self, link: Path, poller: select.epoll) -> None:
        self._link, self._poller = link, poller
        self._hang_up_is_ours = self._deserted = False
        self._open()

    def close(self) -> None:
        """Give the line up; clients see it end."""
        self.unplug()

    def unplug(self) -> None:
        """Pull the adapter out: the port is gone, and clients that had it open see it end."""
        if self.fd < 0:
            return
        self._abandon()
        self.fd, self._deserted = -1, True
        self._link.unlink(missing_ok=True)

    def plug_in(self) -> None:
        """Put the adapter back, under the same name."""
        if self.fd < 0:
            self._deserted = False
            self._open()

    def read(self) -> bytes:
        """Read all that clients have written; empty if there is nothing."""
        chunks = []
        while True:
            try:
                chunks.append(os.read(self.fd, _CHUNK))
            except BlockingIOError:
                self._deserted = False
                break
            except OSError:  # EIO: nothing left, and nobody there
                self._deserted = True
                break
        if chunks or not self._deserted:
            # A client has come: the next hang-up is its own, whether or not ours was ever reported.
            self._hang_up_is_ours = False
        return b"".join(chunks)

    def write(self, data: bytes) -> None:
        """Send bytes; as on a real line, what nobody takes is lost."""
        if not self._deserted:
            with contextlib.suppress(OSError):
                os.write(self.fd, data)

    def renew_if_abandoned(self) -> bool:
        """Bring the line back to new if its last client has gone since the last call.

        Call it after `read` whenever the poller reports a hang-up.

        Returns
        -------
        bool
            Whether a client had gone: what it left half said concerns nobody any more.
        """
        if not self._nobody_there():
            return False
        if self._hang_up_is_ours:
            self._hang_up_is_ours = False
            return False
        try:
            terminal = os.open(self._terminal, os.O_RDWR | os.O_NOCTTY)
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            self._abandon()
            self._open()
        else:
            self._prepare(terminal)
        return True

    def _open(self) -> None:
        self.fd, terminal = os.openpty()
        os.set_blocking(self.fd, False)
        self._terminal = os.ttyname(terminal)
        os.fchmod(terminal, _FOR_EVERYBODY)
        self._prepare(terminal)
        self._poller.register(self.fd, _EVENTS)
        fresh = self._link.with_name(f".{self._link.name}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self._terminal)
        fresh.replace(self._link)

    def _prepare(self, terminal: int) -> None:
        """Leave the terminal as a new one: raw, without echo, unlocked, empty. Closes it."""
        fcntl.ioctl(terminal, termios.TIOCNXCL)
        tty.setraw(terminal, termios.TCSANOW)
        # What nobody read may still be on its way from this end, or lie at the other. What a new client has
        # just written stays.
        termios.tcflush(self.fd, termios.TCOFLUSH)
        termios.tcflush(terminal, termios.TCIFLUSH)
        # Closing it is a hang-up too, the one that says nothing about a client.
        self._hang_up_is_ours = True
        os.close(terminal)

    def _abandon(self) -> None:
        self._poller.unregister(self.fd)
        os.close(self.fd)

    def _nobody_there(self) -> bool:
        probe = select.poll()
        probe.register(self.fd, 0)
        return any(events & select.POLLHUP for _, events in probe.poll(0))
