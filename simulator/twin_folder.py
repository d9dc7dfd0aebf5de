"""The folder of a twin: its ports, its log and the hot folder of its camera."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextlib.contextmanager
def twin_folder(given: str | None) -> Iterator[Path]:
    """Yield a twin's folder, which any user can look into, with its hot folder, which any user can use.

    Parameters
    ----------
    given : str or None
        Where; None makes a folder for the time of the `with` block.

    Raises
    ------
    BadInput
        It cannot be made.
    Refused
        Another twin serves there.
    """
    folder = Path(given).absolute() if given else Path(tempfile.mkdtemp(prefix="gonio-twin-"))
    frames = folder / "frames"
    try:
        try:
            frames.mkdir(parents=True, exist_ok=True)
            frames.chmod(0o777)
            if not given:
                folder.chmod(0o755)
        except OSError as error:
            what = error.strerror or str(error)
            raise BadInput(what, where=str(folder), todo="choose a folder that you can write") from error
        with _alone_in(folder):
            yield folder
    finally:
        if not given:
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep a second twin from taking this one's ports over; a dead twin keeps nobody out."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        todo = "end that one, or choose another --folder"
        raise Refused("another twin serves there", where=str(folder), todo=todo) from error
    finally:
        os.close(handle)
