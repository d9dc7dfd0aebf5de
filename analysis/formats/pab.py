"""PAB (pgII) text, which Radiance's `pabopto2bsdf` reads: one direction of incidence a file.

    #sample_name "paint"
    #format: theta phi BSDF         or BRDF, BTDF; DSF is times cos(theta)
    #intheta 30                     polar angle and azimuth towards the light, in degrees; or both after
    #inphi 0                        #incident_angle
    #upphi 90                       90 leaves Radiance's axes as ours
    #colorimetry: CIE-XYZ           three values a row; CIE-Y one
    10 180 0.25                     theta over 90 is behind the surface

Files put one after the other are read as one set of samples.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.loss import Loss, unchanged
from analysis.formats.scattered import usable
from analysis.formats.tables import Layout, Lines, numbers_of_rows
from analysis.formats.text import looks_like_text, number, read_lines
from analysis.samples import make_samples
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput
from rig.files import whole_file

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "Radiance PAB text"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
SUFFIX = ".pab"

WITH_COSINE = "dsf"
WITHOUT_COSINE = ("bsdf", "brdf", "btdf")
COLOURS = {"cie-y": ["Y"], "cie-xyz": ["X", "Y", "Z"]}
KEYS = ("format", "intheta", "inphi", "incident_angle", "upphi", "colorimetry")
LOWEST_COSINE = 1e-3
NEAR_GRAZING = 1
"""Flag of a value with cosine, so near to the surface that the cosine cannot be taken out."""

SAME_INCIDENCE_DEG = 0.1
SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
"""Linear sRGB (IEC 61966-2-1) to CIE XYZ."""

_FORMAT = re.compile(r"(?im)^#\s*format:\s*theta\s+phi\s+(\w+)")
_ENTRY = re.compile(r"#\s*(\w+):?\s*(.*)")


class _Block(NamedTuple):
    """One file's worth: header entries, rows, and the line where it begins."""

    header: dict[str, str]
    texts: list[str]
    places: list[int]
    line: int


def sniff(head: bytes) -> bool:
    """Whether the text's header names the columns theta and phi."""
    return looks_like_text(head) and _FORMAT.search(head.decode("latin-1")) is not None


def read(path: Path) -> xr.Dataset:
    """Read samples.

    Raises
    ------
    BadInput
        If the header lacks the incidence or the kind of values, or a row is malformed; names the line.
    """
    blocks = [_parse(block, path) for block in _blocks(path)]
    names = [name for *_, name in blocks]
    if any(name != names[0] for name in names):
        raise BadInput("its parts have different channels", where=str(path), todo="read them one by one")
    wi, wo, f_r, flags = (np.concatenate([block[i] for block in blocks]) for i in range(4))
    return make_samples(wi, wo, f_r, channels=names[0], flags=flags, source=path.name)


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write the samples of one direction of incidence.

    Raises
    ------
    BadInput
        If there are several, fewer than 16 samples can be used, or the channels are neither one, nor X, Y, Z,
        nor R, G, B.
    """
    texts, written = _texts(samples)
    if len(texts) > 1:
        raise BadInput(
            f"{len(texts)} directions of incidence, and a PAB file holds one",
            where="samples",
            todo="gonio convert --to pab writes a folder of files, where OUT is one",
        )
    path.write_text(texts[0], encoding="utf-8", newline="\n")
    return unchanged(samples, written)


def write_folder(samples: xr.Dataset, folder: Path) -> tuple[list[Path], Loss]:
    """Write a file for each direction of incidence, as `pabopto2bsdf` takes them.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples of one channel, of X, Y, Z, or of R, G, B, which is taken as linear sRGB. Incidences closer
        than 0.1 deg are one.
    folder : Path
        Made if it is not there.

    Returns
    -------
    paths : list of Path
        The files, by polar angle and azimuth of the light.
    loss : Loss
        What they do not hold.

    Raises
    ------
    BadInput
        As `write`, or if the folder cannot be made.
    """
    texts, written = _texts(samples)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(
            f"cannot be made: {error.strerror}", where=str(folder), todo="choose another folder"
        ) from None
    paths = [folder / f"incidence-{index:03d}.pab" for index in range(1, len(texts) + 1)]
    for path, text in zip(paths, texts, strict=True):
        with whole_file(path) as file:
            file.write_text(text, encoding="utf-8", newline="\n")
    return paths, unchanged(samples, written)


def _texts(samples: xr.Dataset) -> tuple[list[str], int]:
    """Return a file's text for each incidence, and the number of samples in them."""
    given = usable(samples)
    colour, values = _colour([str(name) for name in samples["channel"].to_numpy()], given.f_r)
    theta_i, phi_i = (np.degrees(angle) for angle in direction_to_spherical(given.wi))
    theta_o, phi_o = (np.degrees(angle) for angle in direction_to_spherical(given.wo))
    phi_i = np.where(theta_i < SAME_INCIDENCE_DEG, 0.0, phi_i % 360.0)
    steps = np.round(np.stack([theta_i, phi_i], -1) / SAME_INCIDENCE_DEG).astype(int)
    source = re.sub(r"[^ -!#-~]", "_", str(samples.attrs.get("source", ""))) or "sample"
    texts = []
    for step in np.unique(steps, axis=0):
        rows = np.flatnonzero((steps == step).all(-1))
        head = [
            f'#sample_name "{source}"',
            "#format: theta phi BSDF",
            f"#intheta {theta_i[rows].mean():.6g}",
            f"#inphi {phi_i[rows].mean():.6g}",
            "#upphi 90",
            *([f"#colorimetry: {colour}"] if colour else []),
        ]
        body = [
            " ".join([f"{theta_o[row]:.6f} {phi_o[row] % 360.0:.6f}", *(f"{v:.9g}" for v in values[row])])
            for row in rows
        ]
        texts.append("\n".join([*head, *body]) + "\n")
    return texts, len(given.wi)


def _colour(channels: list[str], f_r: Array) -> tuple[str, Array]:
    """Return the name of the colorimetry, empty where there is none, and the values to write."""
    if len(channels) == 1:
        return "", f_r
    if channels == COLOURS["cie-xyz"]:
        return "CIE-XYZ", f_r
    if channels == ["R", "G", "B"]:
        return "CIE-XYZ", f_r @ SRGB_TO_XYZ.T
    raise BadInput(
        f"channels {', '.join(channels[:4])}{', ...' if len(channels) > 4 else ''}",
        where="samples",
        todo="choose one channel, or X, Y, Z: this format holds no others",
    )


def _blocks(path: Path) -> list[_Block]:
    blocks: list[_Block] = []
    in_header = False
    for line, text in enumerate(read_lines(path), start=1):
        if text.startswith("#"):
            if not in_header:
                blocks.append(_Block({}, [], [], line))
            in_header = True
            entry = _ENTRY.match(text)
            if entry:
                name, value = entry[1].lower(), entry[2].strip()
                if name in KEYS and blocks[-1].header.get(name, value) != value:
                    raise BadInput(
                        f"states {name} a second time, and otherwise",
                        where=f"{path}: line {line}",
                        todo="remove one of them; rows are missing if another file begins here",
                    )
                blocks[-1].header[name] = value
        elif text.strip():
            if not blocks:
                raise BadInput("starts without a header", where=f"{path}: line {line}", todo="copy it again")
            in_header = False
            blocks[-1].texts.append(text)
            blocks[-1].places.append(line)
    return blocks


def _parse(block: _Block, path: Path) -> tuple[Array, Array, Array, NDArray[np.int64], list[str]]:
    """Return directions, values, flags and names of channels."""
    where = f"{path}: line {block.line}"
    cosine = _with_cosine(block.header, where)
    theta_i, phi_i = _incidence(block.header, where)
    if not block.texts:
        raise BadInput("no samples follow the header", where=where, todo="copy the file again")
    colour = block.header.get("colorimetry", "").lower()
    if colour and colour not in COLOURS:
        raise BadInput(
            f"colorimetry {colour[:40]} is not read", where=where, todo=f"known: {', '.join(COLOURS)}"
        )
    names = COLOURS.get(colour) or [str(i) for i in range(len(block.texts[0].split()) - 2)]
    width = max(2 + len(names), 3)
    columns = [str(column) for column in range(1, width + 1)]
    layout = Layout({width: columns}, None, f"not {width}", todo="correct or remove the row", what="columns")
    table = numbers_of_rows(Lines(block.texts, block.places), layout, path).table()
    wrong = np.flatnonzero((table[:, 0] < 0.0) | (table[:, 0] > 180.0))
    if wrong.size:
        raise BadInput(
            f"{table[wrong[0], 0]:g} is not a polar angle from 0 to 180 deg",
            where=f"{path}: line {block.places[wrong[0]]}, column 1",
            todo="this format holds degrees",
        )
    wo = spherical_to_direction(np.radians(table[:, 0]), np.radians(table[:, 1]))
    wi = np.broadcast_to(spherical_to_direction(np.radians(theta_i), np.radians(phi_i)), wo.shape)
    values, flags = table[:, 2:], np.zeros(table[:, 2:].shape, dtype=np.int64)
    if cosine:
        height = np.abs(wo[:, 2:])
        grazing = np.broadcast_to(height < LOWEST_COSINE, values.shape)
        values = np.where(grazing, np.nan, values / np.maximum(height, LOWEST_COSINE))
        flags = np.where(grazing, NEAR_GRAZING, 0)
    return wi, wo, values, flags, names


def _with_cosine(header: dict[str, str], where: str) -> bool:
    *columns, kind = header.get("format", "").lower().split() or [""]
    if columns == ["theta", "phi"] and kind in {WITH_COSINE, *WITHOUT_COSINE}:
        return kind == WITH_COSINE
    raise BadInput(
        "the header does not say what the values are",
        where=where,
        todo="write #format: theta phi BSDF, or DSF where they are times the cosine",
    )


def _incidence(header: dict[str, str], where: str) -> tuple[float, float]:
    words = header.get("incident_angle", "").split()
    if "intheta" in header and "inphi" in header:
        words = [*header["intheta"].split(), *header["inphi"].split()]
    if len(words) != 2:
        raise BadInput("the header lacks the incidence", where=where, todo="write #intheta and #inphi")
    theta, phi = (number(word, where=f"{where}, incidence") for word in words)
    number(header.get("upphi", "90"), where=f"{where}, upphi")
    if not 0.0 <= theta <= 180.0:
        raise BadInput(f"{theta:g} is not a polar angle of incidence", where=where, todo="correct #intheta")
    return theta, phi
