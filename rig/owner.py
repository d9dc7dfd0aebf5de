"""Who owns the machine's ports, and how another process asks him to stop.

The owner writes a lock file, named after the servo port, with a loopback address and a token. Whoever sends
the token there is answered with a stop report. A lock whose owner does not answer is stale and removed:
serial ports are opened exclusively and stay the last guard.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import os
import secrets
import socket
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.errors import Refused
from rig.stop_report import StopReport

if TYPE_CHECKING:
    from collections.abc import Callable

    from rig.description import Rig

LOOPBACK = "127.0.0.1"

CONNECT_S = 1.0
"""How long a living owner may take to take a call."""

WRITE_S = 0.1
"""How long an owner may take from making his lock file to writing it."""

STOP_S = 20.0
"""How long he may take to stop everything, dead servos included."""

LONGEST_MESSAGE = 65_536


@dataclass(frozen=True, slots=True)
class Lock:
    """Content of a lock file."""

    pid: int
    port: int
    token: str

    @classmethod
    def read(cls, path: Path) -> Lock | None:
        """Read a lock file; None where there is none, or it is no lock.

        Raises
        ------
        Refused
            If it belongs to another user.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            return cls(int(content["pid"]), int(content["port"]), str(content["token"]))
        except PermissionError as error:
            raise Refused(
                "another user owns the machine",
                where=str(path),
                todo="have that user run 'gonio rig stop', or remove the file if his program is dead",
            ) from error
        except (OSError, ValueError, KeyError, TypeError):
            return None


def lock_path(servo_port: str) -> Path:
    """Where the lock of a servo port lies: the same for every name of the same port and every rig file."""
    real = os.path.normcase(os.path.realpath(servo_port)) if os.path.exists(servo_port) else servo_port  # noqa: PTH110
    digest = hashlib.sha256(real.encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"gonio-{digest}.lock"


class PortOwner:
    """Owns a machine's ports until released, and answers requests to stop.

    Parameters
    ----------
    rig : Rig
    on_stop : callable
        Stops the machine and reports; called in a thread of the owner.

    Raises
    ------
    Refused
        If a living process owns them.
    """

    def __init__(self, rig: Rig, on_stop: Callable[[], StopReport]) -> None:
        self.path = lock_path(rig.ports.servos)
        self._on_stop = on_stop
        self._token = secrets.token_hex(16)
        self._listener = socket.create_server((LOOPBACK, 0))
        try:
            self._take()
        except BaseException:
            self._listener.close()
            raise
        self._thread = threading.Thread(target=self._serve, name="stop requests", daemon=True)
        self._thread.start()

    def release(self) -> None:
        """Remove the lock and stop listening; a second time does nothing."""
        lock = Lock.read(self.path)
        if lock is not None and lock.token == self._token:
            self.path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes accept(); not every system allows it
        self._listener.close()

    def _take(self) -> None:
        content = {
            "pid": os.getpid(),
            "port": self._listener.getsockname()[1],
            "token": self._token,
        }
        for _ in range(2):
            try:
                handle = os.open(self.path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
            except FileExistsError:
                lock = self._read_written()
                if lock is not None and is_alive(lock):
                    raise Refused(
                        f"process {lock.pid} already runs this machine",
                        where=str(self.path),
                        todo="wait for it, or end it with 'gonio rig stop'",
                    ) from None
                self.path.unlink(missing_ok=True)
                continue
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(content, file)
            return
        raise Refused("another process takes this machine right now", where=str(self.path), todo="try again")

    def _read_written(self) -> Lock | None:
        """Read the lock that is in the way, given its owner the moment between making and writing it."""
        lock = Lock.read(self.path)
        if lock is None:
            time.sleep(WRITE_S)
            lock = Lock.read(self.path)
        return lock

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return  # released
            threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            connection.settimeout(CONNECT_S)
            request = json.loads(_receive(connection))
            if not hmac.compare_digest(str(request["token"]).encode(), self._token.encode()):
                return
            answer: dict[str, object] = {"pid": os.getpid()}
            if request["request"] == "stop":
                answer["report"] = self._on_stop().as_dict()
            connection.settimeout(STOP_S)
            connection.sendall(json.dumps(answer).encode() + b"\n")


def is_alive(lock: Lock) -> bool:
    """Whether the owner of a lock still answers."""
    return _call(lock, "hello", CONNECT_S) is not None


def request_stop(rig: Rig) -> StopReport:
    """Stop a machine, whoever has it: its owner if one lives, else directly over its ports.

    Raises
    ------
    Refused
        If another user owns it, or its owner lives but does not report.
    """
    lock = Lock.read(lock_path(rig.ports.servos))
    if lock is None or not is_alive(lock):
        from rig.unowned import stop_unowned

        return stop_unowned(rig)
    answer = _call(lock, "stop", STOP_S)
    try:
        return StopReport.from_dict((answer or {})["report"])
    except (KeyError, TypeError, ValueError):
        raise Refused(
            f"process {lock.pid} owns the machine but does not report a stop",
            where=rig.name,
            todo="cut the power by hand, then end that process",
        ) from None


def _call(lock: Lock, request: str, timeout_s: float) -> dict[str, Any] | None:
    try:
        with socket.create_connection((LOOPBACK, lock.port), CONNECT_S) as connection:
            connection.settimeout(timeout_s)
            connection.sendall(json.dumps({"token": lock.token, "request": request}).encode() + b"\n")
            answer = json.loads(_receive(connection))
    except (OSError, ValueError):
        return None
    return answer if isinstance(answer, dict) else None


def _receive(connection: socket.socket) -> bytes:
    data = b""
    while not data.endswith(b"\n") and len(data) < LONGEST_MESSAGE:
        more = connection.recv(4096)
        if not more:
            break
        data += more
    return data
