"""Every reader against damaged files: one line that names file and place, or a correct read.

By default each kind of damage once a format; all 1,000 with `-m slow`, after a change of any reader.
"""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import sys
import threading
import zlib
from collections import Counter
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, NamedTuple

import pytest

from tests.analysis.damages import BINARY_DAMAGES, Damage, Effect, text_damages
from tests.analysis.whole_files import Whole, make_merl, make_whole_files

if TYPE_CHECKING:
    from collections.abc import Iterator

MANY = 1000
TOO_LONG_S = 30.0
SLOWEST_BYTES_PER_S = 2e5
"""A reader that has not answered by then hangs; on a quiet machine an answer takes less than 2 s."""

EXPORTS = ("jdv", "raywiz", "lighttools", "speos")
VARIANTS = (
    "csv_german",
    "astm_uncounted",
    "astm_german",
    "bands",
    "fred_scattered",
    "pab_dsf",
    "ssdd_half",
    "alta_half",
    "cornell_one",
    "jdv_one",
)
TEXTS = (
    "cornell",
    "alta",
    "fred",
    "radiance",
    "chassis",
    "zemax",
    "klems",
    "csv",
    "astm",
    "ssdd",
    "pab",
    *EXPORTS,
    *VARIANTS,
)
BINARIES = ("netcdf", "npz", "rgl", "ssdd_binary")
SMALL = (*TEXTS, *BINARIES)


class Reader:
    """A process that reads files one after the other, and is started again when it died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._lines: queue.Queue[str] = queue.Queue()

    def __call__(self, path: Path) -> list:
        """Return outcome, complaint or doubts, digests of rows, seconds of computing, and the most MB."""
        process = self._started()
        process.stdin.write(f"{path}\n")
        process.stdin.flush()
        try:
            line = self._lines.get(timeout=TOO_LONG_S + path.stat().st_size / SLOWEST_BYTES_PER_S)
        except queue.Empty:
            line = ""
        if line:
            return json.loads(line)
        hangs = process.poll() is None
        self.stop()
        return ["failed", "hangs" if hangs else f"the process died ({process.returncode})", [], 0.0, 0.0]

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            with contextlib.suppress(OSError):
                self._process.stdin.close()
            self._process.stdout.close()
            self._process = None

    def _started(self) -> subprocess.Popen[str]:
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("read_damaged.py"))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            self._lines = queue.Queue()
            threading.Thread(target=_pump, args=(self._process.stdout, self._lines), daemon=True).start()
        return self._process


def _pump(stream, lines: queue.Queue[str]) -> None:
    with contextlib.suppress(ValueError):
        for line in stream:
            lines.put(line)
    lines.put("")


@pytest.fixture(scope="module")
def reader() -> Iterator[Reader]:
    """Return one process for all files."""
    if sys.platform != "linux":
        pytest.skip("memory is limited as Linux does it")
    started = Reader()
    yield started
    started.stop()


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, Whole]:
    """Return a small whole file of each format."""
    return make_whole_files(tmp_path_factory.mktemp("whole"))


def complaint_of(file: Whole, damage: Damage, content: bytes, whole: list, answer: list) -> str:
    """Say what is wrong with an answer; empty where it is right."""
    outcome, text, rows = answer[:3]
    if outcome == "failed" or "\n" in text:
        return text
    if outcome == "refused":
        if damage.effect is Effect.KEEPS:
            return f"refused: {text}"
        return "" if "damaged" in text else f"does not name the file: {text}"
    if rows == whole[2]:
        return ""
    return wrong_rows(file, damage, content, Answer(Counter(rows), Counter(whole[2]), rows, whole[2], text))


class Answer(NamedTuple):
    """The rows that were read and those of the whole file, counted and in order, and the doubts."""

    found: Counter[str]
    intact: Counter[str]
    rows: list[str]
    whole: list[str]
    doubts: str


def wrong_rows(  # noqa: PLR0911 - one answer for each effect
    file: Whole, damage: Damage, content: bytes, answer: Answer
) -> str:
    """Say what is wrong with other samples than those of the whole file; empty where they may be read."""
    found, intact, rows, whole, doubts = answer
    other, missing = (found - intact).total(), (intact - found).total()
    counts = f"{len(rows)} samples for {len(whole)}, {other} others, {missing} missing, doubts '{doubts}'"
    if damage.effect is Effect.CUT:
        first = rows[: len(rows) - bool(doubts)] == whole[: len(rows) - bool(doubts)]
        told = doubts or (not file.counted and content.endswith(b"\n"))
        return "" if first and told else f"cut: {counts}"
    if damage.effect is Effect.DOUBLES:
        again = not missing and found.keys() == intact.keys()
        return "" if again and doubts else f"doubled: {counts}"
    if damage.effect is Effect.LOSES:
        few = file.alone and missing > damage.rows_changed
        return f"lost: {counts}" if (other and not doubts) or file.counted or few else ""
    if damage.effect is Effect.KEEPS_OR_REFUSED and doubts and not file.counted:
        return ""
    if damage.effect is not Effect.ANY or file.checked:
        return f"{damage.effect.value} was expected: {counts}"
    if not file.alone:
        return ""
    return "" if max(other, missing) <= damage.rows_changed else f"changed: {counts}"


def answers(reader: Reader, file: Whole, path: Path, count: int | None = None) -> Iterator[tuple[float, str]]:
    """Damage a file in `count` ways, else in each once; give each answer's seconds and complaint."""
    intact = file.path.read_bytes()
    whole = reader(file.path)
    assert whole[0] == "read", whole[1]
    damages = BINARY_DAMAGES if file.binary else text_damages(file.separator)
    random = Random(zlib.crc32(file.path.name.encode()))  # noqa: S311 - seeded on purpose
    for index in range(count or len(damages)):
        damage = damages[index % len(damages)]
        content = damage.change(intact, random)
        if content == intact:
            continue
        path.write_bytes(content)
        answer = reader(path)
        complaint = complaint_of(file, damage, content, whole, answer)
        yield answer[3], f"{index} {damage.name}: {complaint}" if complaint else ""


def survive(reader: Reader, file: Whole, folder: Path, count: int | None = None) -> list[float]:
    """Check the answers to damages; return the seconds of each."""
    found = list(answers(reader, file, folder / "damaged", count))
    wrong = [complaint for _, complaint in found if complaint]
    assert not wrong, "\n".join(wrong)
    return [seconds for seconds, _ in found]


@pytest.mark.parametrize("name", SMALL)
def test_damaged_files(reader, whole, tmp_path, name):
    """Catches a traceback, a hang, memory on a header's word, and a cut file that passes for a whole one."""
    survive(reader, whole[name], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_a_thousand_damaged_files(reader, whole, tmp_path, name):
    """Catches what 60 damages do not meet; run it after a change of a reader."""
    survive(reader, whole[name], tmp_path, MANY)


@pytest.mark.slow
def test_damaged_merl(reader, tmp_path):
    """Catches the same in a table of 35 MB."""
    survive(reader, make_merl(tmp_path), tmp_path, MANY)


@pytest.mark.realdata
@pytest.mark.parametrize("count", [12, pytest.param(MANY, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["vendor-exports/test_excel.xls", "raw/blank_20250829.xls"])
def test_damaged_xls(reader, shared_data, tmp_path, name, count):
    """Catches the same in the sheets of a gonioreflectometer."""
    file = Whole(shared_data / "rt300s" / name, "rt300s", binary=True)
    survive(reader, file, tmp_path, count)


def test_every_format_is_damaged(whole):
    """Catches a new format that nobody damages."""
    from analysis.formats import NAMES

    assert {file.module for file in whole.values()} | {"merl", "rt300s"} == set(NAMES)
