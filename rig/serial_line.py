"""Opening a serial port for one program alone, and saying clearly why it could not be opened."""

from __future__ import annotations

import errno
from typing import Any

import serial

from rig.errors import BadInput, DeviceLost, Refused

WRITE_TIMEOUT_S = 2.0
"""A port that takes no bytes for this long is lost."""


def open_port(port: str, baud: int, *, read_timeout_s: float) -> Any:
    """Open a serial port exclusively.

    Parameters
    ----------
    port : str
        Name or path of the port.
    baud : int
        Bits per second; 8 data bits, no parity, 1 stop bit.
    read_timeout_s : float
        How long one read blocks.

    Returns
    -------
    serial.Serial
        The open port, its input emptied.

    Raises
    ------
    DeviceLost
        If there is no such port.
    Refused
        If another program holds it, or the user may not open it.
    BadInput
        If it is no serial port or cannot do the speed.
    """
    try:
        line = serial.Serial(
            port, baud, timeout=read_timeout_s, write_timeout=WRITE_TIMEOUT_S, exclusive=True
        )
        empty_input(line)
    except (serial.SerialException, OSError, ValueError) as error:
        raise _why(port, baud, error) from error
    return line


def empty_input(line: Any) -> None:
    """Drop all bytes that have arrived.

    Raises
    ------
    serial.SerialException
        If the port is gone.
    """
    try:
        line.reset_input_buffer()
    except Exception as error:  # termios.error is no OSError, and not every system has the module
        raise serial.SerialException(str(error)) from error


def _why(port: str, baud: int, error: Exception) -> BadInput | DeviceLost | Refused:
    number = getattr(error, "errno", None)
    text = str(error).lower()
    if number in {errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO} or "filenotfound" in text:
        return DeviceLost("no such port", where=port, todo=f"plug it in or name another; {_ports_at_hand()}")
    if number in {errno.EAGAIN, errno.EBUSY} or "exclusively lock" in text:
        return Refused(
            "the port is in use by another program", where=port, todo="close it, or run 'gonio rig stop'"
        )
    if number in {errno.EACCES, errno.EPERM} or "permission" in text or "access is denied" in text:
        return Refused(
            "this user may not open the port, or another program holds it",
            where=port,
            todo="on Linux join the port's group (often dialout) and log in again",
        )
    return BadInput(
        f"cannot be opened as a serial port at {baud} baud ({error})", where=port, todo="check port and baud"
    )


def _ports_at_hand() -> str:
    from serial.tools import list_ports

    ports = [entry.device for entry in list_ports.comports()]
    return f"ports at hand: {', '.join(ports)}" if ports else "no serial port is at hand"
