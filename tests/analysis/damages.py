"""What happens to files between laboratories: seeded damages to the bytes of any file."""

from __future__ import annotations

import gzip
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from random import Random

import numpy as np

Change = Callable[[bytes, Random], bytes]

_NUMBER = re.compile(rb"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.])")

_NUMBER_COMMA = re.compile(_NUMBER.pattern.replace(rb"\.\d+", rb"[.,]\d+"))


class Effect(Enum):
    """What a reader may answer; `rows_changed` of a damage widens the last four."""

    KEEPS = "the same samples, nothing else"
    KEEPS_OR_REFUSED = "the same samples, or one line"
    REFUSED = "one line"
    CUT = "one line, all samples, or the first ones with a doubt"
    LOSES = "one line, all samples, or all but those of the lines that are gone"
    DOUBLES = "one line, all samples, or all and some of them again, with a doubt"
    ANY = "one line, or the samples of the lines that nobody touched"


@dataclass(frozen=True)
class Damage:
    """One way to damage a file.

    Attributes
    ----------
    name : str
        What it is called.
    effect : Effect
        What a reader may answer.
    change : callable
        Damages bytes.
    rows_changed : int
        How many samples may be other ones or missing, of a file whose lines are samples of their own.
    """

    name: str
    effect: Effect
    change: Change
    rows_changed: int = 0


def text_damages(separator: bytes | None) -> tuple[Damage, ...]:
    """Return the damages of a text whose cells are separated by this; None for blanks."""
    whole, either = Effect.KEEPS, Effect.KEEPS_OR_REFUSED
    return (
        Damage("CRLF", whole, lambda text, _: _lines(text, b"\r\n")),
        Damage("CR", whole, lambda text, _: _lines(text, b"\r")),
        Damage("mixed line ends", whole, _mixed_ends),
        Damage("byte order mark", whole, lambda text, _: b"\xef\xbb\xbf" + text),
        Damage("blank lines at the end", whole, lambda text, r: text + b"\n" * r.randint(1, 9)),
        Damage(
            "blanks after lines", whole, lambda text, r: text.replace(b"\n", b" " * r.randint(1, 3) + b"\n")
        ),
        Damage("UTF-16", either, lambda text, _: text.decode().encode("utf-16")),
        Damage("UTF-16, big", either, lambda text, _: b"\xfe\xff" + text.decode().encode("utf-16-be")),
        Damage("UTF-16 without mark", either, lambda text, _: text.decode().encode("utf-16-le")),
        Damage("UTF-32", either, lambda text, _: text.decode().encode("utf-32")),
        Damage("double spacing", either, lambda text, _: _lines(text, b"\r\r\n")),
        Damage("blank lines before", either, lambda text, r: b"\n" * r.randint(1, 9) + text),
        Damage(
            "long comment before",
            either,
            lambda text, r: b"# long\n" * r.choice([9, 9_999, 2_000_000]) + text,
        ),
        Damage("tabs to blanks", either, lambda text, _: text.replace(b"\t", b"    ")),
        Damage("blanks to tabs", either, lambda text, _: text.replace(b" ", b"\t")),
        Damage(
            "cells left empty", either, lambda text, _: text.replace(b"\n", (separator or b"\t") * 2 + b"\n")
        ),
        Damage("cells in quotes", either, lambda text, _: _NUMBER.sub(rb'"\g<0>"', text)),
        Damage("sep=", either, lambda text, _: b"sep=" + (separator or b";") + b"\n" + text),
        Damage("upper case", either, lambda text, _: text.upper()),
        Damage("decimal commas", either, _german if separator == b"," else _decimal_commas),
        Damage("decimal commas alone", either, _decimal_commas),
        Damage("one decimal comma", either, _some_number(b"0.5" if separator == b";" else b"0,5")),
        Damage("thousands", either, _some_number(b"1,234.5")),
        Damage("semicolons, one comma", either, _mixed_german),
        *(Damage(f"value {value!r}", Effect.REFUSED, _last_number(value)) for value in NO_VALUES),
        Damage("huge number", Effect.ANY, _some_number(b"99999999999999999999"), 1),
        Damage("huge count", Effect.ANY, _some_number(b"2000000000"), 1),
        Damage("negative", Effect.ANY, _some_number(b"-7"), 1),
        Damage("zero", Effect.ANY, _some_number(b"0"), 1),
        Damage("one more", Effect.ANY, _one_off(1), 1),
        Damage("one less", Effect.ANY, _one_off(-1), 1),
        Damage("underscores", either, _some_number(b"1_0")),
        Damage("other digits", either, _some_number("٣".encode())),
        Damage("number lost", either, _some_number(b"")),
        Damage("numbers in one", either, _join_numbers),
        Damage("line doubled", Effect.DOUBLES, _double_lines(1)),
        Damage("lines doubled", Effect.DOUBLES, _double_lines(5)),
        Damage("twice in one file", Effect.DOUBLES, lambda text, _: text + text),
        Damage("line lost", Effect.LOSES, _lose_lines(1), 1),
        Damage("lines lost", Effect.LOSES, _lose_lines(3), 3),
        Damage("line end lost", either, _lose_line_end),
        Damage("front lost", Effect.LOSES, lambda text, r: text[r.randrange(len(text)) :], 1_000),
        Damage("lines exchanged", Effect.ANY, _exchange_lines),
        Damage("commented out", Effect.LOSES, lambda text, r: _insert(text, r, b"#"), 1),
        Damage("Latin-1", either, lambda text, r: _insert(text, r, "µ°é".encode("latin-1"))),
        Damage("zero bytes", either, lambda text, r: _insert(text, r, b"\0" * r.randint(1, 5))),
        Damage("control characters", either, lambda text, r: _insert(text, r, b"\x0b\x0c\x1c\x85\x1a")),
        Damage("long line", either, lambda text, r: _insert(text, r, b"1 " * 200_000)),
        Damage("deep brackets", either, lambda text, r: _insert(text, r, b"<a>" * 50_000)),
        Damage("quotes", either, lambda text, r: _insert(text, r, b'"')),
        Damage("compressed", Effect.REFUSED, lambda text, _: gzip.compress(text)),
        Damage("another file", Effect.REFUSED, lambda _, r: r.choice(OTHER_FILES)),
        *DAMAGES,
    )


NO_VALUES = (
    b"nan", b"NaN", b"inf", b"-Infinity", b"1e999", b"0.2.5", b"n/a", b"#N/A", b"#VALUE!", b"-", b"",
    b"1.0D-3", b"0x1p3", b"1e", b"01.Feb", b"1 000", b"1e30", "0.5\u2009".encode() + b"e-3", "−0.5".encode(),
)  # fmt: skip
"""What programs and people write where a number should be."""

OTHER_FILES = (
    b"<!DOCTYPE html>\n<html><head><title>404 Not Found</title></head><body>1 2 3</body></html>\n",
    b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22e\nsize 12345\n",
    b"%PDF-1.7\n1 0 obj\n<<>>\n",
    bytes(5000),
    b"\xff" * 5000,
    b" \n\n \n",
    b"0",
)
"""What stands under a file's name after a bad download or copy."""


def _lines(text: bytes, end: bytes) -> bytes:
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\n", end)


def _decimal_commas(text: bytes, _: Random) -> bytes:
    return re.sub(rb"(?<=\d)\.(?=\d)", b",", text)


def _german(text: bytes, random: Random) -> bytes:
    """As a German spreadsheet saves a table: semicolons between cells, commas in numbers."""
    return _decimal_commas(text.replace(b",", b";"), random)


def _mixed_german(text: bytes, random: Random) -> bytes:
    """One number with a comma among those with points, where cells are separated by semicolons."""
    return _put(changed := text.replace(b",", b";"), random.choice(_numbers(changed)), b"0,5")


def _numbers(text: bytes) -> list[re.Match[bytes]]:
    return list((_NUMBER_COMMA if b";" in text else _NUMBER).finditer(text))


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


def _double_lines(count: int) -> Change:
    def change(text: bytes, random: Random) -> bytes:
        lines = text.split(b"\n")
        place = random.randrange(len(lines))
        return b"\n".join([*lines[: place + count], *lines[place:]])

    return change


def _lose_lines(count: int) -> Change:
    def change(text: bytes, random: Random) -> bytes:
        lines = text.split(b"\n")
        place = random.randrange(len(lines) - count)
        return b"\n".join(lines[:place] + lines[place + count :])

    return change


def _lose_line_end(text: bytes, random: Random) -> bytes:
    lines = text.split(b"\n")
    place = random.randrange(1, len(lines))
    return b"\n".join([*lines[: place - 1], b"".join(lines[place - 1 : place + 1]), *lines[place + 1 :]])


def _mixed_ends(text: bytes, random: Random) -> bytes:
    return b"".join(line + random.choice([b"\n", b"\r\n", b"\r"]) for line in text.splitlines())


def _join_numbers(text: bytes, random: Random) -> bytes:
    """Lose what separates two numbers."""
    numbers = _numbers(text)
    place = random.randrange(1, len(numbers))
    return text[: numbers[place - 1].end()] + text[numbers[place].start() :]


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


def _all_other_order(width: int) -> Change:
    """Reverse the bytes of all words behind some heading."""

    def change(content: bytes, random: Random) -> bytes:
        start = random.choice([0, 12, 16, 64, 80, 128, 256])
        count = (len(content) - start) // width
        words = np.frombuffer(content, np.uint8, count * width, min(start, len(content))).reshape(-1, width)
        return content[:start] + words[:, ::-1].tobytes() + content[start + count * width :]

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
    Damage("a bit", Effect.ANY, _flip(1), 1),
    Damage("bits", Effect.ANY, _flip(8), 8),
    Damage("garbage", Effect.ANY, _garbage, 5),
    Damage("zeroed block", Effect.ANY, _zeroed),
)

BINARY_DAMAGES = (
    *DAMAGES,
    *DAMAGES[1:],
    Damage("byte order, 2", Effect.ANY, _other_order(2)),
    Damage("byte order, 4", Effect.ANY, _other_order(4)),
    Damage("byte order, 8", Effect.ANY, _other_order(8)),
    Damage("all in the other order, 4", Effect.ANY, _all_other_order(4)),
    Damage("all in the other order, 8", Effect.ANY, _all_other_order(8)),
    Damage("compressed", Effect.REFUSED, lambda content, _: gzip.compress(content)),
    Damage("another file", Effect.REFUSED, lambda _, r: r.choice(OTHER_FILES)),
    Damage("twice in one file", Effect.DOUBLES, lambda content, _: content + content),
    Damage("front lost", Effect.REFUSED, lambda content, r: content[r.randint(1, len(content) // 2) :]),
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
