"""Words of the lines that say what a station holds: key=value pairs and numbers, refused in one line."""

from __future__ import annotations

import difflib
import math
from typing import TYPE_CHECKING

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterable

CHANNELS = 3
EXAMPLE = "write for example lambert:kd=0.5"

Value = float | tuple[float, ...]


def pairs(spec: str, text: str) -> dict[str, str]:
    """Split `key=value,key=value`.

    Parameters
    ----------
    spec : str
        The whole line, for errors.
    text : str
        The part of it that holds the pairs.

    Raises
    ------
    BadInput
        What is no pair, or a key that comes twice.
    """
    found: dict[str, str] = {}
    for item in filter(None, (part.strip() for part in text.split(","))):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not (key and equals and value):
            raise BadInput(f"{item!r} is not key=value", where=spec, todo=EXAMPLE)
        if key in found:
            raise BadInput(f"{key} is given twice", where=spec, todo="give it once")
        found[key] = value
    return found


def numbers(spec: str, key: str, text: str) -> Value:
    """Read one number, or three that slashes separate.

    Raises
    ------
    BadInput
        What is no finite number, or another count of them.
    """
    try:
        values = tuple(float(part) for part in text.split("/"))
    except ValueError:
        raise BadInput(f"{key}={text} is not a number", where=spec, todo=EXAMPLE) from None
    if len(values) not in {1, CHANNELS}:
        what = f"{key} has {len(values)} values"
        raise BadInput(what, where=spec, todo="give one, or three as red/green/blue")
    if not all(math.isfinite(value) for value in values):
        raise BadInput(f"{key}={text} is not finite", where=spec, todo="correct the value")
    return values[0] if len(values) == 1 else values


def number(spec: str, key: str, text: str) -> float:
    """Read one number; raises as `numbers`."""
    value = numbers(spec, key, text)
    if isinstance(value, tuple):
        raise BadInput(f"{key} has {len(value)} values", where=spec, todo="give one")
    return value


def hint(word: str, known: Iterable[str], of: str = "known") -> str:
    """Say which known word may have been meant, or which `of` them there are."""
    known = list(known)
    nearest = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {nearest[0]}?" if nearest else f"{of}: {', '.join(known)}"
