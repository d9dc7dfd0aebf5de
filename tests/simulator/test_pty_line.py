"""A line that outlives its clients, whoever they are and however they go."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import signal
import sys
import tempfile
import termios
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

# Here and not where it is needed: another user may not read this checkout.
from simulator.pty_line import PtyLine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals as Linux has them")

NOBODY = 65_534
ROOT = os.geteuid() == 0
AS_USERS = [None, NOBODY] if ROOT else [None]


def fork(work: Callable[[], None], user: int | None) -> int:
    """Run something in a process of its own, as another user if asked; its process ID."""
    pid = os.fork()
    if pid:
        return pid
    try:
        if user is not None:
            os.setgroups([])
            os.setgid(user)
            os.setuid(user)
        work()
        os._exit(0)
    except BaseException as error:  # noqa: BLE001 - a forked child must not run the parent's clean-up
        sys.stderr.write(f"child: {error!r}\n")
    finally:
        os._exit(1)


class Server(NamedTuple):
    """Who serves a line: where, as which user, and where it says that it has brought the line back to new."""

    link: Path
    user: int | None
    renewed: int


def echo_upper(link: Path, renewed: int) -> None:
    """Serve the line for ever: what arrives goes back in capitals."""
    poller = select.epoll()
    line = PtyLine(link, poller)
    while True:
        for _, events in poller.poll():
            line.write(line.read().upper())
            if events & select.EPOLLHUP and line.renew_if_abandoned():
                os.write(renewed, b"!")


@pytest.fixture(params=AS_USERS, ids=lambda user: "nobody" if user else "myself")
def server(request: pytest.FixtureRequest) -> Iterator[Server]:
    """Serve a line as any user that can be had."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o777)
        link = Path(folder) / "line"
        renewed, tell = os.pipe()
        pid = fork(lambda: echo_upper(link, tell), request.param)
        os.close(tell)
        deadline = time.monotonic() + 30.0
        while not link.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        yield Server(link, request.param, renewed)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(renewed)


def open_line(link: Path) -> int:
    """Open the line as a client, waiting out the moment in which it is renewed."""
    deadline = time.monotonic() + 30.0
    while True:
        try:
            return os.open(link, os.O_RDWR | os.O_NOCTTY)
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.001)


def exchange(fd: int, data: bytes, wanted: int, wait_s: float = 30.0) -> bytes:
    """Write and read until so many bytes have come or time is up."""
    os.write(fd, data)
    received = b""
    deadline = time.monotonic() + wait_s
    while len(received) < wanted and (left := deadline - time.monotonic()) > 0:
        if select.select([fd], [], [], left)[0]:
            received += os.read(fd, 4096)
    return received


def client_that_is_killed(server: Server, user: int | None, *, exclusive: bool) -> None:
    """Let a client use the line, leave answers unread, lock it if asked, and be killed with the port open."""
    ready, tell = os.pipe()

    def work() -> None:
        fd = open_line(server.link)
        if exclusive:
            fcntl.ioctl(fd, termios.TIOCEXCL)
        assert exchange(fd, b"hello", 5) == b"HELLO"
        os.write(fd, b"never read")
        mode = termios.tcgetattr(fd)
        mode[3] |= termios.ECHO | termios.ICANON
        termios.tcsetattr(fd, termios.TCSANOW, mode)
        os.write(tell, b"!")
        time.sleep(60)

    pid = fork(work, user)
    os.close(tell)
    assert os.read(ready, 1) == b"!", "the client could not use the line"
    os.close(ready)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    # No client follows another sooner than a program starts; a fork of this process would.
    assert os.read(server.renewed, 1) == b"!"


@pytest.mark.parametrize("exclusive", [False, True], ids=["shared", "exclusive"])
@pytest.mark.parametrize("user", AS_USERS, ids=lambda user: "nobody" if user else "myself")
def test_a_killed_client_is_followed_by_another(server: Server, user: int | None, exclusive: bool) -> None:
    """Catches a port that stays locked, echoes, or hands the dead client's answers to the next one."""
    if server.user is not None and user is None:
        pytest.skip("root may do anything; the lines that nobody serves are for nobody")
    for _ in range(3):
        client_that_is_killed(server, user, exclusive=exclusive)
    client_that_is_killed(server, NOBODY if ROOT else None, exclusive=exclusive)


def test_a_new_line_is_raw_and_open_to_everybody(server: Server) -> None:
    """Catches an echo loop before the first client has set raw mode, and ports for root only."""
    fd = open_line(server.link)
    assert not termios.tcgetattr(fd)[3] & (termios.ECHO | termios.ICANON)
    assert os.fstat(fd).st_mode & 0o666 == 0o666
    assert exchange(fd, bytes(range(32)), 32) == bytes(range(32))
    os.close(fd)


def test_bytes_of_a_client_that_left_at_once_are_still_heard(tmp_path: Path) -> None:
    """Catches the last words of a client that writes and exits, such as a stop, being thrown away."""
    poller = select.epoll()
    line = PtyLine(tmp_path / "line", poller)
    fd = open_line(tmp_path / "line")
    tty.setraw(fd)
    os.write(fd, b"stop")
    os.close(fd)
    assert line.read() == b"stop"
    line.close()
    assert not (tmp_path / "line").exists()
    with contextlib.suppress(OSError):
        poller.close()


def test_a_client_that_follows_at_once_is_known_to_have_left(tmp_path: Path) -> None:
    """Catches the line's own hang-up, never reported because somebody came, taken for the next client's."""
    with contextlib.closing(select.epoll()) as poller:
        line = PtyLine(tmp_path / "line", poller)
        for _ in range(3):
            fd = open_line(tmp_path / "line")
            os.write(fd, b"hello")
            assert line.read() == b"hello"
            os.close(fd)
            assert line.read() == b""
            assert line.renew_if_abandoned()
        line.close()


def test_nobody_there_costs_nothing(tmp_path: Path) -> None:
    """Catches a busy loop: a line without a client must let the poller sleep."""
    with contextlib.closing(select.epoll()) as poller:
        line = PtyLine(tmp_path / "line", poller)
        turns = 0
        end = time.monotonic() + 0.2
        while (left := end - time.monotonic()) > 0:
            for _ in poller.poll(left):
                line.read()
                line.renew_if_abandoned()
                turns += 1
        assert turns <= 2
        line.close()
