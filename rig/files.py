"""Writing files whole: what was there before stays until all of the new content is on the disk."""

from __future__ import annotations

import contextlib
import errno
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
"""What the system says when there is no room."""


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a place beside a file to write to; it takes the file's name when the block ends well.

    Otherwise it is removed and an earlier file stays as it was. What is no plain file, such as a device or
    a pipe, is written to directly.

    Parameters
    ----------
    path : path
        The file to make or to replace.

    Yields
    ------
    Path
        Where to write.

    Raises
    ------
    Refused
        The disk is full.
    BadInput
        The file cannot be written there.
    """
    target = Path(path)
    try:
        if target.exists() and not target.is_file():
            yield target
            return
        place = target.resolve()  # a link keeps pointing where it points
        aside = place.with_name(f".{place.stem}.part{place.suffix}")
        try:
            yield aside
            aside.replace(place)
        finally:
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise _in_one_line(error, target) from error


def _in_one_line(error: OSError, path: Path) -> BadInput | Refused:
    # Libraries pass the system's answer on in their own words only.
    if error.errno in FULL or "No space left" in str(error):
        return Refused("the disk is full", where=str(path), todo="free some space, or choose another place")
    what = error.strerror or " ".join(str(error).split())
    return BadInput(f"cannot be written: {what}", where=str(path), todo="choose another place")
