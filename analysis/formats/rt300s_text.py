"""What the RT-300S exports for other programs: text of one or more blocks, one for each incidence.

    JDV          DataType: BRDF(RT-300S)   rows of laser azimuth, columns of receive angle
    Raywiz       DataType: BRDF(Raywiz)    rows of receive, columns of azimuth, given by their ends
    LightTools   Name / Comment :          the same, given by begin, end and step
    Speos .rtd   OPTIS - Anisotropic       the same, named in the table; the incidence ends the SampleID

Values are percents of the RT of the `.xls` export (the exports of one measurement agree in that), so f_r =
value / 100 / (pi cos(theta_r)), with its directions. A block of nothing but zeros was not measured: it is
flagged. What the files hold beyond the readings (Speos: a mirrored table) is left.
"""

from __future__ import annotations

import re
from enum import IntFlag
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.rt300s import Export, readings_of, reduced
from analysis.formats.tables import bulk, plain_table
from analysis.formats.text import looks_like_text, number, read_lines
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "RT-300S text export"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
PERCENT = 0.01
MOST_ANGLES = 100_000
FINEST_STEP_DEG = 0.01
"""Steps of the instrument are multiples of this; where lines are lost, equal steps are none."""

SAME_STEP = 1e-6
_START = re.compile(
    r"DataType:\t *BRDF\((?:RT-300S|Raywiz)\)|Name / Comment :|OPTIS - Anisotropic BSDF surface file v1\.0"
)
_SNIFF = re.compile(
    rb"\A(?:DataType:\t *BRDF\((?:RT-300S|Raywiz)\)"
    rb"|Name / Comment :[^\n]*\n(?:[^\n]*\n){1,20}Theta Lighting\t"
    rb"|OPTIS - Anisotropic BSDF surface file v1\.0)"
)
_LAST_NUMBER = re.compile(r"(?:\A|\s)(-?[0-9]+(?:\.[0-9]+)?)\s*\Z")
_WORD = re.compile(r"[^\W\d_]{2}")


class Flag(IntFlag):
    """Why a reading may not be used, beside what `rt300s` says."""

    EMPTY_BLOCK = 1 << 8
    """The block holds nothing but zeros."""


_Line = tuple[int, str]


class _Block(NamedTuple):
    """A block's lines: their numbers in the file and texts."""

    lines: list[_Line]
    path: Path

    @property
    def where(self) -> str:
        return f"{self.path}: line {self.lines[0][0]}"

    def entry(self, name: str) -> str:
        """Return what stands behind a name."""
        for _, text in self.lines:
            if name in text and (cells := _cells(text))[0] == name and len(cells) > 1:
                return cells[1]
        raise BadInput(f"has no entry '{name}'", where=self.where, todo="copy or export the file again")

    def value(self, name: str) -> float:
        return number(self.entry(name), where=f"{self.where}, {name}")

    def after(self, name: str) -> list[_Line]:
        """Return the lines behind the one that starts so, up to the first empty one."""
        starts = [index for index, (_, text) in enumerate(self.lines) if text.lstrip(" ").startswith(name)]
        if not starts:
            raise BadInput(f"has no line '{name}'", where=self.where, todo="copy or export the file again")
        rows = self.lines[starts[0] + 1 :]
        end = next((index for index, (_, text) in enumerate(rows) if not text.strip()), len(rows))
        # Speos' second table is numbers; words are the head of a block whose first line is damaged.
        stray = next((line for line, text in rows[end:] if _WORD.search("".join(_cells(text)))), None)
        if stray is not None:
            raise BadInput(
                "words follow the end of a table",
                where=f"{self.path}: line {stray}",
                todo="the line that begins another block is missing or damaged: export it again",
            )
        return rows[:end]


class _Table(NamedTuple):
    """One incidence: its angles and the readings (receive, azimuth), in the instrument's degrees.

    `stated` tells whether the block says how many receive angles there are; Raywiz gives their ends only.
    """

    incidence: float
    azimuth: Array
    receive: Array
    value: Array
    stated: bool = True


def sniff(head: bytes) -> bool:
    """Whether the first line is one of the four programs'."""
    return looks_like_text(head) and _SNIFF.match(head) is not None


def read(path: Path) -> xr.Dataset:
    """Read all blocks.

    Raises
    ------
    BadInput
        If a block lacks an entry, its table does not have the size that its angles ask for, or a cell is no
        number; names the line.
    """
    tables = [_table(block) for block in _blocks(path)]
    if len({len(table.receive) for table in tables if not table.stated}) > 1:
        raise BadInput(
            "has tables of different lengths between the same angles",
            where=str(path),
            todo="the file is damaged or cut short: export it again",
        )
    angles, values, empty = [], [], []
    for table in tables:
        receive, azimuth = np.meshgrid(table.receive, table.azimuth, indexing="ij")
        angles.append(
            np.stack([np.full(receive.size, table.incidence), azimuth.ravel(), receive.ravel()], axis=1)
        )
        values.append(table.value.ravel())
        empty.append(np.full(receive.size, not table.value.any()))
    export = Export(np.concatenate(angles), np.concatenate(values) * PERCENT)
    samples = reduced(readings_of(export, path.name), path.name)
    flags = samples["flags"].to_numpy() | np.where(np.concatenate(empty), int(Flag.EMPTY_BLOCK), 0)[:, None]
    return samples.assign(flags=(samples["flags"].dims, flags, samples["flags"].attrs))


def _blocks(path: Path) -> list[_Block]:
    blocks: list[_Block] = []
    for line, text in enumerate(read_lines(path), start=1):
        if _START.match(text):
            blocks.append(_Block([], path))
        if not blocks:
            raise BadInput("starts without a header", where=f"{path}: line {line}", todo="export it again")
        blocks[-1].lines.append((line, text))
    return blocks


def _cells(text: str) -> list[str]:
    return [cell.strip() for cell in text.split("\t")]


def _table(block: _Block) -> _Table:
    first = _cells(block.lines[0][1])
    if first[0] == "DataType:":
        return _raywiz(block) if "Raywiz" in first[1] else _jdv(block)
    table = _lighttools(block) if first[0].startswith("Name") else _speos(block)
    return _checked(table, block)


def _jdv(block: _Block) -> _Table:
    head, *rows = block.after("Raw data") or [(block.lines[-1][0], "")]
    receive = _numbers(head, block.path, skip=1)
    azimuth, value = _labelled(rows, len(receive), block)
    for name, angles in (("Polar:", receive), ("Azimuth:", azimuth)):
        ends = [number(word, where=f"{block.where}, {name}") for word in block.entry(name).split(",")]
        if len(ends) != 3 or not _same(angles, _steps(ends[0], ends[1], ends[2], block.where)):
            raise _wrong_size(block, f"{name} {block.entry(name)}")
    return _checked(_Table(block.value("Incidence:"), azimuth, receive, value.T), block)


def _raywiz(block: _Block) -> _Table:
    rows = block.after("Date:")
    if len(rows) < 4:
        raise _wrong_size(block, "counts, angles and an incidence")
    counts, ends, incidence = (_numbers(row, block.path) for row in rows[:3])
    if len(counts) != 3 or len(ends) != 4 or len(incidence) != 1 or not 1 <= counts[2] <= MOST_ANGLES:
        raise _wrong_size(block, "three counts, four angles and one incidence")
    azimuth = np.linspace(ends[0], ends[1], int(counts[2]))
    receive = np.linspace(ends[2], ends[3], len(rows) - 3)
    step = (ends[3] - ends[2]) / max(len(receive) - 1, 1)
    if abs(step / FINEST_STEP_DEG - round(step / FINEST_STEP_DEG)) > SAME_STEP:
        raise _wrong_size(block, f"{len(receive)} receive angles from {ends[2]:g} to {ends[3]:g} deg")
    cells = [_numbers(row, block.path, width=len(azimuth)) for row in rows[3:]]
    return _checked(_Table(float(incidence[0]), azimuth, receive, np.array(cells), stated=False), block)


def _lighttools(block: _Block) -> _Table:
    azimuth, receive = _measured(block, "Phi"), _measured(block, "Theta")
    found, value = _labelled(block.after("Theta Lighting"), len(azimuth), block)
    if not _same(found, receive):
        raise _wrong_size(block, f"{len(receive)} receive angles")
    return _Table(block.value("Theta Lighting"), azimuth, receive, value)


def _measured(block: _Block, angle: str) -> Array:
    begin, end, step = (block.value(f"{angle} measure {what} :") for what in ("beginning", "end", "step"))
    return _steps(begin, end, step, block.where)


def _speos(block: _Block) -> _Table:
    name = _LAST_NUMBER.search(block.entry("SampleID:"))
    if name is None:
        raise BadInput(
            "does not say its incidence", where=block.where, todo="end the SampleID with the incidence in deg"
        )
    spectrum = block.after("Reflection Spectrum")
    # A count, so many lines of the spectrum, and then the table.
    count = int(_numbers(spectrum[0], block.path, width=1)[0]) if spectrum else -1
    table = spectrum[1 + count :] if 0 <= count < len(spectrum) - 2 else []
    if not table:
        raise _wrong_size(block, "a spectrum and a table")
    if _cells(table[0][1])[0]:
        raise _wrong_size(block, f"{count} lines of a spectrum and a line of azimuths")
    azimuth = _numbers(table[0], block.path, skip=1)
    receive, value = _labelled(table[1:], len(azimuth), block)
    return _Table(float(name[1]), azimuth, receive, value)


def _numbers(row: _Line, path: Path, *, skip: int = 0, width: int | None = None) -> Array:
    line, cells = row[0], _cells(row[1])
    while cells and not cells[-1]:
        cells = cells[:-1]
    values = bulk(cells[skip:])
    if values is None:
        values = np.array(
            [
                number(cell, where=f"{path}: line {line}, column {column}")
                for column, cell in enumerate(cells[skip:], start=skip + 1)
            ]
        )
    if width is not None and len(values) != width:
        raise BadInput(
            f"has {len(values)} numbers, not {width}",
            where=f"{path}: line {line}",
            todo="the file is damaged or cut short: export it again",
        )
    return values


def _labelled(rows: list[_Line], width: int, block: _Block) -> tuple[Array, Array]:
    """Return the rows' angles and their values, shape (rows, width)."""
    if not rows or not width:
        raise _wrong_size(block, "a table")
    table = plain_table([text.rstrip() for _, text in rows], "\t", 1 + width)
    if table is None:
        table = np.array([_numbers(row, block.path, width=1 + width) for row in rows])
    return table[:, 0], table[:, 1:]


def _steps(begin: float, end: float, step: float, where: str) -> Array:
    count = round((end - begin) / step) + 1 if step else 1
    if not 1 <= count <= MOST_ANGLES:
        raise BadInput(
            f"{begin:g} to {end:g} by {step:g} is no list of angles", where=where, todo="copy it again"
        )
    return np.asarray(begin + step * np.arange(count), dtype=np.float64)


def _same(a: Array, b: Array) -> bool:
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=0.0, atol=1e-3))


def _checked(table: _Table, block: _Block) -> _Table:
    for angles in (table.azimuth, table.receive):
        steps = np.diff(angles)
        if not ((steps > 0.0).all() or (steps < 0.0).all()):
            raise _wrong_size(block, "angles that ascend, each once")
    if abs(table.incidence) >= 90.0 or np.abs(table.receive).max() >= 90.0:
        raise BadInput(
            "an incidence or receive angle is 90 deg or more", where=block.where, todo="remove the block"
        )
    return table


def _wrong_size(block: _Block, wanted: str) -> BadInput:
    return BadInput(
        f"does not hold what its header asks for: {wanted}",
        where=block.where,
        todo="the file is damaged or cut short: export it again",
    )
