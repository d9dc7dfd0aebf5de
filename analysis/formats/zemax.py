"""Zemax OpticStudio's tabulated `.bsdf`: a grid of directions counted from the mirror direction.

Header words with their lists (`SampleRotation`, `AngleOfIncidence`, `ScatterAzimuth`, `ScatterRadial`, each a
count and so many degrees), then for each channel `DataBegin`, and for each sample rotation and incidence a
`TIS` and one row an azimuth, one cell a radial angle; `DataEnd`.

The radial angle is counted from the mirror direction, the azimuth around it from the direction in the plane
of incidence that leads to the normal (and, beyond it, to the light); in plane-symmetric files 0 to 180 stands
for both sides. Cells below the horizon belong to no sample and are dropped, and so are all but the first of
the cells at a radial angle of 0, which are one direction. The format has no mark for "not measured":
laboratories write 0, so a cell of exactly 0 is flagged.
"""

from __future__ import annotations

import re
from enum import IntFlag
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.loss import Loss, compared
from analysis.formats.text import looks_like_text
from analysis.formats.words import Words
from analysis.samples import make_samples
from rig.angles import direction_to_spherical, spherical_to_direction, turned, wrap
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "Zemax .bsdf"
SUFFIX = ".zemax.bsdf"
OPTIONS: tuple[str, ...] = ()
SYMMETRIES = ("PlaneSymmetrical", "ASymmetrical", "Asymmetrical", "ASymmetrical4D")
CHANNELS = {"Monochrome": ("Monochrome",), "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ")}
LISTS = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
MOST_ANGLES = 100_000
MOST_CELLS = 20_000_000
AZIMUTHS_DEG = np.arange(0.0, 181.0, 10.0)
RADIALS_DEG = np.array([0, 1, 2, 3.5, 5, 7.5, 10, 15, 20, 25, 30, 40, 50, 60, 70, 80, 90, 105, 120, 140, 160])
SAME_ANGLE_DEG = 1e-3
FEWEST_OF_CELLS = 3
"""Samples stand on a grid of their own if it has at most so many cells for each of them."""
HORIZON = 1e-9
_WORDS = re.compile(rb"^[ \t]*(?:AngleOfIncidence|ScatterRadial)[ \t]", re.MULTILINE)


class Flag(IntFlag):
    """Why a cell may not be used."""

    NOT_MEASURED = 1
    """The cell is exactly 0, which is what is written where nothing was measured."""


class Grid(NamedTuple):
    """The four lists of angles, in degrees."""

    rotation_deg: Array
    incidence_deg: Array
    azimuth_deg: Array
    radial_deg: Array


class Lists(NamedTuple):
    """The angles of a written grid, in radians."""

    azimuth: Array
    radial: Array


def sniff(head: bytes) -> bool:
    """Whether the header has this format's lists of angles."""
    return looks_like_text(head) and _WORDS.search(head) is not None


def directions(theta_i: Array, azimuth: Array, radial: Array) -> Array:
    """Return the directions at an azimuth and a radial angle from the mirror direction.

    Parameters
    ----------
    theta_i, azimuth, radial : ndarray
        Angles in radians, broadcast; the light stands at azimuth 0 of the sample.

    Returns
    -------
    ndarray, shape (..., 3)
    """
    along, across, forward = np.moveaxis(spherical_to_direction(radial, azimuth), -1, 0)
    sin_i, cos_i = np.sin(theta_i), np.cos(theta_i)
    return np.stack([cos_i * along - sin_i * forward, across, sin_i * along + cos_i * forward], axis=-1)


def read(path: Path) -> xr.Dataset:
    """Read samples of reflection.

    Raises
    ------
    BadInput
        If the header is incomplete, a count does not hold, or a number is malformed; names line and column.
    """
    words = Words(path)
    grid, names = _header(words, path)
    shape = tuple(len(angles) for angles in grid)
    values = np.stack([_channel(words, name, shape) for name in names], axis=-1)
    if words.left:
        word = words.take("nothing")
        raise BadInput(
            f"'{word.text[:40]}' follows the end of the data",
            where=words.where(word),
            todo="the header counts too few angles, or another file follows: copy it again",
        )
    rotation, incidence, azimuth, radial = (
        np.radians(angles).ravel() for angles in np.meshgrid(*grid, indexing="ij")
    )
    wo = turned(directions(incidence, azimuth, radial), rotation)
    wi = spherical_to_direction(incidence, rotation)
    # A radial angle of 0 is one direction, repeated in the row of each azimuth.
    repeated = np.broadcast_to((np.arange(shape[2])[:, None] > 0) & (grid.radial_deg == 0.0), shape)
    above = (wo[:, 2] > HORIZON) & ~repeated.ravel()
    cells = values.reshape(-1, len(names))[above]
    return make_samples(
        wi[above],
        wo[above],
        cells,
        channels=[name.removeprefix("Tristimulus") for name in names],
        flags=np.where(cells == 0.0, int(Flag.NOT_MEASURED), 0),
        source=path.name,
    )


def _header(words: Words, path: Path) -> tuple[Grid, tuple[str, ...]]:
    lists: dict[str, Array] = {}
    names: tuple[str, ...] = ()
    while words.left and words.peek() not in {"Monochrome", "TristimulusX"}:
        word = words.take("a word of the header")
        if word.text in lists:
            raise BadInput(f"states {word.text} a second time", where=words.where(word), todo="remove one")
        if word.text in LISTS:
            lists[word.text] = words.numbers(words.count("angles", MOST_ANGLES), f"all of {word.text}")
        elif word.text == "Symmetry":
            words.expect(*SYMMETRIES)
        elif word.text == "SpectralContent":
            names = CHANNELS[words.expect(*CHANNELS).text]
        elif word.text == "ScatterType":
            words.expect("BRDF")
        elif word.text == "Source":
            words.take("the source")
        else:
            raise BadInput(
                f"'{word.text[:40]}' is no word of the header",
                where=words.where(word),
                todo="the file is damaged or counts its angles wrongly: copy it again",
            )
    lists.setdefault("SampleRotation", np.zeros(1))
    missing = [name for name in LISTS if name not in lists] + ([] if names else ["SpectralContent"])
    if missing:
        raise BadInput(f"has no {missing[0]}", where=f"{path}: line 1", todo="copy the file again")
    grid = Grid(*(lists[name] for name in LISTS))
    _check_ranges(grid, path)
    return grid, names


def _check_ranges(grid: Grid, path: Path) -> None:
    for name, angles, largest in (
        ("AngleOfIncidence", grid.incidence_deg, 90.0),
        ("ScatterRadial", grid.radial_deg, 180.0),
    ):
        wrong = angles[(angles < 0.0) | (angles > largest)]
        if wrong.size:
            raise BadInput(
                f"{wrong[0]:g} in {name} is not in 0 to {largest:g} deg", where=str(path), todo="correct it"
            )
    if np.prod([float(len(angles)) for angles in grid]) > MOST_CELLS:
        raise BadInput(
            "announces more cells than gonio reads", where=str(path), todo="check the counts of angles"
        )


def _channel(words: Words, name: str, shape: tuple[int, ...]) -> Array:
    """Read one channel's blocks; shape (rotations, incidences, azimuths, radials)."""
    words.expect(name)
    words.expect("DataBegin")
    rotations, incidences, azimuths, radials = shape
    blocks = []
    for _ in range(rotations * incidences):
        words.expect("TIS")
        words.numbers(1, "the TIS")
        blocks.append(words.numbers(azimuths * radials, "all cells of an incidence"))
    words.expect("DataEnd")
    return np.stack(blocks).reshape(shape)


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write one channel as a plane-symmetric grid; what the grid loses is told in the file's comments.

    The sample is taken as isotropic and mirror-symmetric: azimuths are folded onto 0 to 180 deg. Samples that
    stand on such a grid keep it, with 0 in cells that have none. Else each incidence is interpolated linearly
    between its samples (in the mirror direction's azimuthal projection); outside their hull cells are 0, as
    the format wants it.

    Raises
    ------
    BadInput
        If there is more than one channel, or no incidence with samples enough to interpolate.
    """
    if samples.sizes["channel"] != 1:
        raise BadInput(
            f"Zemax holds one channel, here are {samples.sizes['channel']}",
            where="samples",
            todo="choose one, by its wavelength or its name",
        )
    usable = (samples["flags"].to_numpy()[:, 0] == 0) & np.isfinite(samples["f_r"].to_numpy()[:, 0])
    value = samples["f_r"].to_numpy()[usable, 0]
    theta_i, phi_i = direction_to_spherical(samples["wi"].to_numpy()[usable])
    azimuth, radial = _specular_angles(theta_i, phi_i, samples["wo"].to_numpy()[usable])
    incidences = _distinct(np.degrees(theta_i))
    own = _own_lists(azimuth, radial, incidences.size)
    lists = own or Lists(np.radians(AZIMUTHS_DEG), np.radians(RADIALS_DEG))
    tables, back, filled = [], np.empty_like(value), 0
    for incidence in incidences:
        chosen = np.abs(np.degrees(theta_i) - incidence) <= SAME_ANGLE_DEG
        if np.count_nonzero(chosen) < 4:
            raise BadInput(
                f"fewer than 4 are at incidence {incidence:g} deg",
                where="samples",
                todo="leave that incidence out or measure on a grid",
            )
        place = _placed if own else _resampled
        table, outside = place(azimuth[chosen], radial[chosen], value[chosen], lists)
        back[chosen] = _read_back(azimuth[chosen], radial[chosen], table, lists)
        tables.append(table)
        filled += int(np.count_nonzero(outside & _seen(incidence, lists)))
    cells = sum(int(np.count_nonzero(_seen(incidence, lists))) for incidence in incidences)
    wi, wo = (samples[name].to_numpy()[usable] for name in ("wi", "wo"))
    loss = compared(samples, wi, wo, value[:, None], back[:, None], cells=cells, filled=filled)
    path.write_text(_page(samples, incidences, tables, lists, loss), encoding="utf-8")
    return loss


def _specular_angles(theta_i: Array, phi_i: Array, wo: Array) -> tuple[Array, Array]:
    """Return the azimuth, folded to [0, pi], and the radial angle of view directions."""
    x, y, z = turned(wo, -phi_i).T
    sin_i, cos_i = np.sin(theta_i), np.cos(theta_i)
    local = np.stack([cos_i * x + sin_i * z, y, -sin_i * x + cos_i * z], axis=-1)
    radial, azimuth = direction_to_spherical(local)
    return np.abs(wrap(azimuth)), radial


def _distinct(angles_deg: Array) -> Array:
    """Return the different angles; those closer than the tolerance count as one."""
    ordered = np.unique(angles_deg)
    new = np.concatenate([[True], np.diff(ordered) > SAME_ANGLE_DEG])
    distinct: Array = np.round(ordered[new], 6)
    return distinct


def _plane(azimuth: Array, radial: Array) -> Array:
    return np.stack([radial * np.cos(azimuth), radial * np.sin(azimuth)], axis=-1)


def _own_lists(azimuth: Array, radial: Array, incidences: int) -> Lists | None:
    """Return the grid that the samples stand on, from azimuth 0 to pi and from radial 0; None if on none."""
    around = azimuth[radial > np.radians(SAME_ANGLE_DEG)]
    if not around.size:
        return None
    lists = Lists(*(np.radians(_distinct(np.degrees(angles))) for angles in (around, radial)))
    cells = lists.azimuth.size * lists.radial.size * incidences
    few = lists.azimuth.size > 1 and cells <= FEWEST_OF_CELLS * len(radial)
    ends = (lists.radial[0], *lists.azimuth[[0, -1]] - [0.0, np.pi]) if few else ()
    return lists if few and np.all(np.abs(ends) <= np.radians(SAME_ANGLE_DEG)) else None


def _placed(azimuth: Array, radial: Array, value: Array, lists: Lists) -> tuple[Array, NDArray[np.bool_]]:
    """Put one incidence's samples on their own grid (azimuths, radials); 0 in cells without, and where."""
    slack = np.radians(SAME_ANGLE_DEG)
    here = np.abs(azimuth[:, None, None] - lists.azimuth[:, None]) <= slack
    here = (here | (lists.radial <= slack)) & (np.abs(radial[:, None, None] - lists.radial) <= slack)
    count = here.sum(axis=0)
    table = np.einsum("nar,n->ar", here, value) / np.maximum(count, 1)
    return table, count == 0


def _seen(incidence_deg: float, lists: Lists) -> NDArray[np.bool_]:
    """Which cells of the grid lie above the horizon; shape (azimuths, radials)."""
    wo = directions(np.radians(incidence_deg), lists.azimuth[:, None], lists.radial)
    return np.asarray(wo[..., 2] > HORIZON)


def _resampled(azimuth: Array, radial: Array, value: Array, lists: Lists) -> tuple[Array, NDArray[np.bool_]]:
    """Interpolate one incidence on the grid (azimuths, radials); 0 outside of the samples, and where."""
    from scipy.interpolate import LinearNDInterpolator

    # Both sides of the plane of incidence, so that the hull has no edge along it.
    points = np.concatenate([_plane(azimuth, radial), _plane(-azimuth, radial)])
    points, first = np.unique(np.round(points, 9), axis=0, return_index=True)
    interpolate = LinearNDInterpolator(points, np.concatenate([value, value])[first])
    grid = np.meshgrid(*lists, indexing="ij")
    table = np.asarray(interpolate(_plane(*grid)), dtype=np.float64)
    outside = np.isnan(table)
    return np.where(outside, 0.0, table), outside


def _read_back(azimuth: Array, radial: Array, table: Array, lists: Lists) -> Array:
    """Give the grid's value at each sample, linearly; 0 beyond the grid."""
    from scipy.interpolate import RegularGridInterpolator

    back = RegularGridInterpolator(lists, table, bounds_error=False, fill_value=0.0)
    # What stands on the last line of the grid, but for rounding, is not beyond it.
    slack = np.radians(SAME_ANGLE_DEG)
    onto = [
        np.where(np.abs(angle - listed[-1]) <= slack, listed[-1], angle)
        for angle, listed in zip((azimuth, radial), lists, strict=True)
    ]
    return np.asarray(back(np.stack(onto, axis=-1)))


def _page(samples: xr.Dataset, incidences: Array, tables: list[Array], lists: Lists, loss: Loss) -> str:
    lines = [
        f"# samples: {str(samples.attrs.get('source', '')).strip()[:200]}",
        f"# channel: {samples['channel'].to_numpy()[0]}",
        f"# change of the samples by this grid, read back linearly: {loss}",
        "# isotropy and mirror symmetry are taken for granted; 0 stands where there are no samples",
        "Source\tMeasured",
        "Symmetry\tPlaneSymmetrical",
        "SpectralContent\tMonochrome",
        "ScatterType\tBRDF",
        *_list("SampleRotation", np.zeros(1)),
        *_list("AngleOfIncidence", incidences),
        *_list("ScatterAzimuth", np.asarray(np.degrees(lists.azimuth).round(6), dtype=np.float64)),
        *_list("ScatterRadial", np.asarray(np.degrees(lists.radial).round(6), dtype=np.float64)),
        "",
        "Monochrome",
        "DataBegin",
    ]
    for incidence, table in zip(incidences, tables, strict=True):
        lines.append(f"TIS\t{_tis(float(np.radians(incidence)), table, lists):.6f}")
        lines += ["\t".join(f"{cell:.8e}" for cell in row) for row in table]
    return "\n".join([*lines, "DataEnd", ""])


def _list(name: str, angles_deg: Array) -> list[str]:
    return [f"{name}\t{len(angles_deg)}", "\t".join(f"{angle:g}" for angle in angles_deg)]


def _tis(theta_i: float, table: Array, lists: Lists) -> float:
    """Return the total integrated scatter of one table: the integral of f cos(theta_o) over directions."""
    azimuth, radial = lists
    cosine = directions(np.asarray(theta_i), azimuth[:, None], radial[None, :])[..., 2]
    inner = np.trapezoid(table * np.clip(cosine, 0.0, None) * np.sin(radial), radial, axis=1)
    return float(2.0 * np.trapezoid(inner, azimuth))
