"""What happens to files between laboratories: seeded damages to the bytes of any file."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from random import Random

Change = Callable[[bytes, Random], bytes]

_NUMBER = re.compile(rb"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.])")


class Effect(Enum):
    """What a reader may answer."""

    KEEPS = "the same samples, nothing else"
    KEEPS_OR_REFUSED = "the same samples, or one line"
    CUT = "one line, all samples, or fewer with a doubt"
    REFUSED = "one line"
    ANY = "one line, or some samples"


@dataclass(frozen=True)
class Damage:
    """One way to damage a file."""

    name: str
    effect: Effect
    change: Change


def text_damages(separator: bytes | None) -> tuple[Damage, ...]:
    """Return the damages of a text whose cells are separated by this; None for blanks."""
    decimal = _german if separator == b"," else _decimal_commas
    return (
        Damage("CRLF", Effect.KEEPS, lambda text, _: _lines(text, b"\r\n")),
        Damage("CR", Effect.KEEPS, lambda text, _: _lines(text, b"\r")),
        Damage("byte order mark", Effect.KEEPS, lambda text, _: b"\xef\xbb\xbf" + text),
        Damage("blank lines at the end", Effect.KEEPS, lambda text, r: text + b"\n" * r.randint(1, 9)),
        Damage(
            "blanks after lines",
            Effect.KEEPS,
            lambda text, r: text.replace(b"\n", b" " * r.randint(1, 3) + b"\n"),
        ),
        Damage("decimal commas", Effect.KEEPS_OR_REFUSED, decimal),
        Damage("UTF-16", Effect.KEEPS_OR_REFUSED, lambda text, _: text.decode("latin-1").encode("utf-16")),
        Damage("not a number", Effect.REFUSED, _last_number(b"nan")),
        Damage("infinite", Effect.REFUSED, _last_number(b"inf")),
        Damage("out of range", Effect.REFUSED, _last_number(b"1e999")),
        Damage("two points", Effect.REFUSED, _last_number(b"0.2.5")),
        Damage("a word", Effect.REFUSED, _last_number(b"n/a")),
        Damage("huge number", Effect.ANY, _some_number(b"99999999999999999999")),
        Damage("huge count", Effect.ANY, _some_number(b"2000000000")),
        Damage("negative", Effect.ANY, _some_number(b"-7")),
        Damage("zero", Effect.ANY, _some_number(b"0")),
        Damage("one more", Effect.ANY, _one_off(1)),
        Damage("one less", Effect.ANY, _one_off(-1)),
        Damage("underscores", Effect.ANY, _some_number(b"1_0")),
        Damage("other digits", Effect.ANY, _some_number("٣".encode())),
        Damage("number lost", Effect.ANY, _some_number(b"")),
        Damage("line doubled", Effect.ANY, _double_line),
        Damage("line lost", Effect.ANY, _lose_line),
        Damage("lines exchanged", Effect.ANY, _exchange_lines),
        Damage("Latin-1", Effect.ANY, lambda text, r: _insert(text, r, "µ°é".encode("latin-1"))),
        Damage("zero bytes", Effect.ANY, lambda text, r: _insert(text, r, b"\0" * r.randint(1, 5))),
        Damage("control characters", Effect.ANY, lambda text, r: _insert(text, r, b"\x0b\x0c\x1c\x85\x1a")),
        Damage("long line", Effect.ANY, lambda text, r: _insert(text, r, b"1 " * 200_000)),
        Damage("deep brackets", Effect.ANY, lambda text, r: _insert(text, r, b"<a>" * 50_000)),
        Damage("quotes", Effect.ANY, lambda text, r: _insert(text, r, b'"')),
        *DAMAGES,
    )


def _lines(text: bytes, end: bytes) -> bytes:
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\n", end)


def _decimal_commas(text: bytes, _: Random) -> bytes:
    return re.sub(rb"(?<=\d)\.(?=\d)", b",", text)


def _german(text: bytes, random: Random) -> bytes:
    """As a German spreadsheet saves a table: semicolons between cells, commas in numbers."""
    return _decimal_commas(text.replace(b",", b";"), random)


def _numbers(text: bytes) -> list[re.Match[bytes]]:
    return list(_NUMBER.finditer(text))


def _put(text: bytes, number: re.Match[bytes], new: bytes) -> bytes:
    return text[: number.start()] + new + text[number.end() :]


def _last_number(new: bytes) -> Change:
    """Replace one of the last numbers: a value, in every format."""
    return lambda text, _: _put(text, _numbers(text)[-1], new)


def _some_number(new: bytes) -> Change:
    return lambda text, random: _put(text, random.choice(_numbers(text)), new)


def _one_off(step: int) -> Change:
    """Change a whole number by one: counts are among them."""

    def change(text: bytes, random: Random) -> bytes:
        whole = [n for n in _numbers(text) if n[0].isdigit()] or _numbers(text)
        number = random.choice(whole)
        return _put(text, number, b"%d" % (int(float(number[0])) + step))

    return change


def _insert(content: bytes, random: Random, new: bytes) -> bytes:
    place = random.randrange(len(content) + 1)
    return content[:place] + new + content[place:]


def _double_line(text: bytes, random: Random) -> bytes:
    lines = text.split(b"\n")
    place = random.randrange(len(lines))
    return b"\n".join([*lines[: place + 1], *lines[place:]])


def _lose_line(text: bytes, random: Random) -> bytes:
    lines = text.split(b"\n")
    del lines[random.randrange(len(lines))]
    return b"\n".join(lines)


def _exchange_lines(text: bytes, random: Random) -> bytes:
    lines = text.split(b"\n")
    a, b = random.randrange(len(lines)), random.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _cut(content: bytes, random: Random) -> bytes:
    """Cut anywhere, or near the end, where a cut is hardest to see."""
    keep = random.randrange(len(content)) if random.random() < 0.5 else len(content) - random.randint(1, 40)
    return content[: max(keep, 0)]


def _flip(bits: int) -> Change:
    def change(content: bytes, random: Random) -> bytes:
        changed = bytearray(content)
        for _ in range(bits):
            # Half of them in the head, where the structure is.
            end = len(changed) if random.random() < 0.5 else min(len(changed), 2048)
            changed[random.randrange(end)] ^= 1 << random.randrange(8)
        return bytes(changed)

    return change


def _other_order(width: int) -> Change:
    """Reverse the bytes of some neighbouring words, or of all from a place on."""

    def change(content: bytes, random: Random) -> bytes:
        changed = bytearray(content)
        start = random.randrange(0, max(min(len(content), 4096) - width, 1))
        count = 1 if random.random() < 0.5 else (len(content) - start) // width
        for place in range(start, start + count * width, width):
            changed[place : place + width] = changed[place : place + width][::-1]
        return bytes(changed)

    return change


def _huge_word(layout: str, value: int) -> Change:
    """Overwrite a word with a huge number: sizes, counts and offsets are among them."""
    new = struct.pack(layout, value)

    def change(content: bytes, random: Random) -> bytes:
        place = random.randrange(max(min(len(content), 4096) - len(new), 1))
        return content[:place] + new + content[place + len(new) :]

    return change


def _not_a_number(content: bytes, random: Random) -> bytes:
    place = random.randrange(max(len(content) - 8, 1))
    return content[:place] + struct.pack("<d", float("nan")) + content[place + 8 :]


def _garbage(content: bytes, random: Random) -> bytes:
    start = random.randrange(len(content))
    return (
        content[:start] + random.randbytes(random.randint(1, 64)) + content[start + random.randint(0, 64) :]
    )


def _zeroed(content: bytes, random: Random) -> bytes:
    """Put zeros where 512 bytes should be: a block that a copy lost."""
    start = random.randrange(len(content)) // 512 * 512
    return content[:start] + bytes(len(content[start : start + 512])) + content[start + 512 :]


DAMAGES = (
    Damage("empty", Effect.REFUSED, lambda _content, _random: b""),
    Damage("cut", Effect.CUT, _cut),
    Damage("a bit", Effect.ANY, _flip(1)),
    Damage("bits", Effect.ANY, _flip(8)),
    Damage("garbage", Effect.ANY, _garbage),
    Damage("zeroed block", Effect.ANY, _zeroed),
)

BINARY_DAMAGES = (
    *DAMAGES,
    *DAMAGES[1:],
    Damage("byte order, 2", Effect.ANY, _other_order(2)),
    Damage("byte order, 4", Effect.ANY, _other_order(4)),
    Damage("byte order, 8", Effect.ANY, _other_order(8)),
    Damage("huge 2", Effect.ANY, _huge_word("<H", 0xFFFF)),
    Damage("huge 4", Effect.ANY, _huge_word("<I", 0x7FFFFFFF)),
    Damage("huge 4 unsigned", Effect.ANY, _huge_word("<I", 0xFFFFFFFF)),
    Damage("huge 8", Effect.ANY, _huge_word("<Q", 1 << 40)),
    Damage("huge 8 signed", Effect.ANY, _huge_word("<Q", 0x7FFFFFFFFFFFFFFF)),
    Damage("not a number", Effect.ANY, _not_a_number),
    Damage("lengthened", Effect.ANY, lambda content, r: content + r.randbytes(r.randint(1, 100))),
    Damage("shifted", Effect.ANY, lambda content, r: _insert(content, r, b"\0")),
    Damage("CRLF", Effect.ANY, lambda content, _: content.replace(b"\n", b"\r\n")),
)
"""As if a transfer in text mode had damaged it too; cuts and flips count double."""
