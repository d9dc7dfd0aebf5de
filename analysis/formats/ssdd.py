"""Surface scattering distribution data (SSDD, Kimura): tables over grids of angles in degrees.

Written against version 0.2 of its specification, whose entries and order later 0.x versions keep. Read: the
BRDF block of a file, as text or binary (little-endian single precision, as libbsdf writes it), in all three
parametrisations (spherical; specular, counted as Zemax does; half-difference); other blocks are skipped.
Cells with a direction below the horizon are dropped. Written: one BRDF as text in spherical coordinates, only
from samples that fill a grid, so that nothing is resampled; uncertainties are lost.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.doubts import ATTRIBUTE, UNFINISHED, unfinished
from analysis.formats.loss import Loss, unchanged
from analysis.formats.tables import Layout, Lines, numbers_of_rows
from analysis.formats.text import decoded_lines, looks_like_text, number, read_lines
from analysis.formats.zemax import directions
from analysis.samples import make_samples
from rig.angles import direction_to_spherical, from_half_difference, rotation, spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "SSDD"
SUFFIX = ".ssdd"
VERSION = "0.2"
OPTIONS: tuple[str, ...] = ()
COUNTS = {"monochrome": 1, "rgb": 3, "xyz": 3}
SYSTEMS = ("spherical_coordinate_system", "specular_coordinate_system", "half_difference_coordinate_system")
HORIZON = 1e-9
MOST_CELLS = 4_000_000
LARGEST_BYTES = 256 * 1024**2
STORED = np.dtype("<f4")
SAME_DEG = 1e-6
_START = re.compile(rb"\A(?:\xef\xbb\xbf)?(?:#[^\r\n]*[\r\n]+|\s)*+VERSION[ \t]+\d")
_DATA_TYPE = re.compile(rb"^[ \t]*DATA_TYPE[ \t]", re.MULTILINE)
_BINARY = re.compile(rb"^[ \t]*DATA[ \t]+binary[ \t]*(?:# [^\r\n]*)?\r?\n", re.MULTILINE)
_COMMENT = re.compile(r"(?:^|\s)#\s")

Line = tuple[int, str]
"""Number of a line and what stands on it, without comment."""


class Entry(NamedTuple):
    """A line of meta-data: its words after the name, and where it stands."""

    words: list[str]
    where: str


class Block(NamedTuple):
    """The lines of one block, and the bytes of its table where that is binary."""

    lines: list[Line]
    table: bytes | None


def sniff(head: bytes) -> bool:
    """Whether the file starts with a version and has a block's first entry."""
    binary = _BINARY.search(head)
    text = head[: binary.start()] if binary else head
    return looks_like_text(text) and _START.match(text) is not None and _DATA_TYPE.search(text) is not None


def read(path: Path) -> xr.Dataset:
    """Read the samples of the file's BRDF.

    Raises
    ------
    BadInput
        If there is no BRDF, an entry is missing or unknown, or the table has the wrong size or a malformed
        number; names line and column.
    """
    for block in _blocks(path):
        if block.lines[0][1].split()[1:] == ["brdf"]:
            return _samples(block, path)
    raise BadInput("holds no BRDF", where=f"{path}: line 1", todo="gonio reads reflection only")


def _blocks(path: Path) -> list[Block]:
    """Cut a file into its blocks; a binary table is as long as the entries before it say."""
    if path.stat().st_size > LARGEST_BYTES:
        raise BadInput("is larger than any table of samples", where=str(path), todo="store it as NetCDF")
    content = path.read_bytes()
    binary = _BINARY.search(content)
    if binary is None:
        return [Block(lines, None) for lines in _text_blocks(_with_content(read_lines(path), first=1))]
    blocks: list[Block] = []
    start, first = 0, 1
    while binary is not None:
        text = decoded_lines(content[start : binary.end()])
        found = _text_blocks(_with_content(text, first=first))
        if not found:
            raise BadInput("a table belongs to no DATA_TYPE", where=f"{path}: line {first}")
        end = binary.end() + _binary_bytes(found[-1], path)
        if end > len(content):
            raise BadInput(
                f"{len(content) - binary.end()} bytes follow DATA binary, the lists announce "
                f"{end - binary.end()}",
                where=f"{path}: line {found[-1][-1][0]}",
                todo="the file is cut short or a list is wrong: copy it again",
            )
        blocks += [Block(lines, None) for lines in found[:-1]]
        blocks.append(Block(found[-1], content[binary.end() : end]))
        start, first = end, first + len(text)
        binary = _BINARY.search(content, start)
    rest = _with_content(decoded_lines(content[start:]), first=first)
    if rest and rest[0][1].split()[0] != "DATA_TYPE":
        raise BadInput(
            f"{len(content) - start} bytes follow a binary table that are no block",
            where=f"{path}: byte {start}",
            todo="a list is wrong, or the table is not in single precision",
        )
    return blocks + [Block(lines, None) for lines in _text_blocks(rest)]


def _with_content(lines: list[str], *, first: int) -> list[Line]:
    """Return lines under their number, without comments and empty lines."""
    content = [
        (line, _COMMENT.split(text, maxsplit=1)[0].strip() if "#" in text else text.strip())
        for line, text in enumerate(lines, start=first)
    ]
    return [(line, text) for line, text in content if text]


def _text_blocks(lines: list[Line]) -> list[list[Line]]:
    starts = [index for index, (_, text) in enumerate(lines) if _begins(text, "DATA_TYPE")]
    return [lines[start:end] for start, end in pairwise([*starts, len(lines)])]


def _begins(text: str, name: str) -> bool:
    """Whether a line's first word is this name."""
    return text.startswith(name) and text.split(maxsplit=1)[0] == name


def _head(lines: list[Line], path: Path) -> tuple[dict[str, Entry], int]:
    """Return a block's entries by name, and how many lines they take."""
    end = next((index for index, (_, text) in enumerate(lines) if _begins(text, "DATA")), None)
    if end is None:
        raise BadInput("has no entry DATA", where=f"{path}: line {lines[-1][0]}", todo="copy the file again")
    entries: dict[str, Entry] = {}
    for line, text in lines[: end + 1]:
        name, *words = text.split()
        if name in entries:
            raise BadInput(
                f"states {name[:40]} a second time", where=f"{path}: line {line}", todo="remove one of them"
            )
        entries[name] = Entry(words, f"{path}: line {line}")
    return entries, end + 1


def _binary_bytes(lines: list[Line], path: Path) -> int:
    """Return how long a block's binary table is; of specular blocks only the first two lists count."""
    entries, _ = _head(lines, path)
    channels, _ = _channels(entries, path)
    axes = 4 if "PARAM_TYPE" in entries else 2
    sizes = [len(entries[name].words) for i in range(axes) if (name := f"PARAM{i}_LIST") in entries]
    return int(np.prod([float(size) for size in sizes])) * len(channels) * STORED.itemsize


def _samples(block: Block, path: Path) -> xr.Dataset:
    entries, length = _head(block.lines, path)
    channels, wavelengths = _channels(entries, path)
    grid = [_angles(entries, f"PARAM{index}_LIST", required=index != 1, path=path) for index in range(4)]
    count = int(np.prod([float(len(angles)) for angles in grid]))
    if count > MOST_CELLS:
        raise BadInput(
            f"the lists announce {count} cells, gonio reads {MOST_CELLS}", where=entries["DATA"].where
        )
    table = _table(block, length, (count, len(channels)), path)
    # The first parameter runs fastest.
    cells = np.stack([axis.ravel(order="F") for axis in np.meshgrid(*map(np.radians, grid), indexing="ij")])
    wi, wo = _directions(cells, entries, path)
    above = (wi[:, 2] > HORIZON) & (wo[:, 2] > HORIZON)
    samples = make_samples(
        wi[above],
        wo[above],
        table[above],
        channels=None if wavelengths is not None else channels,
        wavelength_nm=wavelengths,
        source=path.name,
    )
    # The rows of a text are counted; only its last number may be cut unseen.
    doubtful = block.table is None and unfinished(path)
    return samples.assign_attrs({ATTRIBUTE: UNFINISHED}) if doubtful else samples


def _table(block: Block, length: int, shape: tuple[int, int], path: Path) -> Array:
    """Return the values (cells, channels) that follow a block's entries."""
    last, text = block.lines[length - 1]
    where, mode = f"{path}: line {last}", text.split()[1:]
    if block.table is not None:
        if len(block.table) != shape[0] * shape[1] * STORED.itemsize:
            raise BadInput("the lists do not announce the table's size", where=where, todo="copy it again")
        table = np.frombuffer(block.table, STORED).reshape(shape).astype(np.float64)
        wrong = np.argwhere(~np.isfinite(table))
        if len(wrong):
            raise BadInput(
                "holds a value that is not finite",
                where=f"{where}, cell {wrong[0][0] + 1}, channel {wrong[0][1] + 1}",
                todo="correct it where it was made",
            )
        return table
    if mode != ["ascii"]:
        raise BadInput(
            f"DATA is '{' '.join(mode)[:40]}'", where=where, todo="known: ascii, binary; lines end in LF"
        )
    body = block.lines[length:]
    if len(body) != shape[0]:
        raise BadInput(
            f"{len(body)} rows follow, the lists announce {shape[0]}",
            where=f"{path}: line {block.lines[-1][0]}",
            todo="the file is cut short or a list is wrong: copy it again",
        )
    columns = [str(column) for column in range(1, shape[1] + 1)]
    layout = Layout({shape[1]: columns}, None, expected=f"the colour model {shape[1]}")
    rows = Lines([text for _, text in body], [line for line, _ in body])
    return numbers_of_rows(rows, layout, path).table()


def _entry(entries: dict[str, Entry], name: str, path: Path) -> Entry:
    if name not in entries:
        raise BadInput(f"has no entry {name}", where=f"{path}: line 1", todo="add it or copy the file again")
    return entries[name]


def _channels(entries: dict[str, Entry], path: Path) -> tuple[list[str], Array | None]:
    model = _entry(entries, "COLOR_MODEL", path)
    name = " ".join(model.words)
    if name == "spectrum":
        wavelengths = _angles(entries, "WAVELENGTH_LIST", required=True, path=path)
        return [f"{w:g} nm" for w in wavelengths], wavelengths
    if name not in COUNTS:
        raise BadInput(
            f"colour model '{name[:40]}' is unknown",
            where=model.where,
            todo=f"known: {', '.join(COUNTS)}, spectrum",
        )
    return (["monochrome"] if name == "monochrome" else list(name.upper())), None


def _angles(entries: dict[str, Entry], name: str, *, required: bool, path: Path) -> Array:
    if name not in entries and not required:
        return np.zeros(1)
    entry = _entry(entries, name, path)
    if not entry.words:
        raise BadInput(f"{name} is empty", where=entry.where, todo="list at least one number")
    angles = np.array(
        [
            number(word, where=f"{entry.where}, column {column}")
            for column, word in enumerate(entry.words, start=2)
        ]
    )
    back = np.flatnonzero(np.diff(angles) <= 0.0)
    if back.size:
        raise BadInput(
            f"{angles[back[0] + 1]:g} does not ascend",
            where=f"{entry.where}, column {back[0] + 3}",
            todo="lists of this format do: the file is damaged",
        )
    return angles


def _directions(cells: Array, entries: dict[str, Entry], path: Path) -> tuple[Array, Array]:
    system = _entry(entries, "PARAM_TYPE", path)
    name = " ".join(system.words)
    if name == SYSTEMS[0]:
        return spherical_to_direction(cells[0], cells[1]), spherical_to_direction(cells[2], cells[3])
    if name == SYSTEMS[1]:
        if "PARAM4_LIST" in entries:
            raise BadInput(
                "offsets from the mirror direction are not read",
                where=entries["PARAM4_LIST"].where,
                todo="export the BRDF without PARAM4_LIST",
            )
        local = directions(cells[0], cells[3], cells[2])
        turn = rotation(np.array([0.0, 0.0, 1.0]), cells[1])
        return spherical_to_direction(cells[0], cells[1]), np.einsum("nij,nj->ni", turn, local)
    if name == SYSTEMS[2]:
        wi, wo = from_half_difference(*cells)
        return wi, wo
    raise BadInput(
        f"'{name[:40]}' is no parametrisation", where=system.where, todo=f"known: {', '.join(SYSTEMS)}"
    )


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write samples that fill a grid of theta_i, phi_i, theta_o and phi_o.

    Where the light has one azimuth, view azimuths are counted from it (isotropic data in this format).

    Raises
    ------
    BadInput
        If directions of the grid are missing, measured twice, flagged or without value.
    """
    angles = [
        np.degrees(angle)
        for name in ("wi", "wo")
        for angle in direction_to_spherical(samples[name].to_numpy())
    ]
    light = np.unique(np.round(angles[1] % 360.0 / SAME_DEG)) * SAME_DEG
    if len(light) == 1:
        angles[3] = angles[3] - light[0]
        angles[1] = np.zeros_like(angles[1])
    keys = [np.round(angle / SAME_DEG).astype(np.int64) for angle in angles]
    keys[1], keys[3] = (key % round(360.0 / SAME_DEG) for key in (keys[1], keys[3]))
    lists, places = zip(*(np.unique(key, return_inverse=True) for key in keys), strict=True)
    shape = tuple(len(values) for values in lists)
    usable = np.isfinite(samples["f_r"].to_numpy()).all(axis=1) & (samples["flags"].to_numpy() == 0).all(
        axis=1
    )
    missing = int(np.prod([float(size) for size in shape])) - np.count_nonzero(usable)
    flat = np.ravel_multi_index(places, shape, order="F")
    if missing or len(np.unique(flat)) != len(flat):
        raise BadInput(
            f"the samples do not fill their grid of {' x '.join(map(str, shape))} directions",
            where="samples",
            todo="SSDD holds full grids only: select such samples, or write NetCDF, CSV or ASTM",
        )
    table = samples["f_r"].to_numpy()[np.argsort(flat)]
    lines = [f"VERSION {VERSION}", "SOFTWARE gonio", "", "DATA_TYPE brdf", *_model(samples)]
    lines.append(f"PARAM_TYPE {SYSTEMS[0]}")
    for index, values in enumerate(lists):
        if index != 1 or len(values) > 1:
            lines.append(f"PARAM{index}_LIST " + " ".join(f"{value * SAME_DEG:.10g}" for value in values))
    lines += ["SOURCE_TYPE measured", "DATA ascii"]
    lines += [" ".join(repr(float(value)) for value in row) for row in table]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return unchanged(samples, len(table), kept=("wavelength_nm",))


def _model(samples: xr.Dataset) -> list[str]:
    names = [str(name).lower() for name in samples["channel"].to_numpy()]
    for model in ("rgb", "xyz"):
        if names == list(model):
            return [f"COLOR_MODEL {model}"]
    if "wavelength_nm" in samples.coords:
        wavelengths = samples["wavelength_nm"].to_numpy()
        return ["COLOR_MODEL spectrum", "WAVELENGTH_LIST " + " ".join(f"{w:.10g}" for w in wavelengths)]
    if len(names) == 1:
        return ["COLOR_MODEL monochrome"]
    raise BadInput(
        f"channels {', '.join(names[:5])} are neither RGB, XYZ nor wavelengths",
        where="samples",
        todo="select one channel or name the wavelengths",
    )
