"""A ColorChecker in a merged picture: found, measured in the merge itself, and put in order.

The chart is found in eight bits by OpenCV's detector, or given by its corners; its patches are then measured
in radiance, where nothing is cut. A chart may lie turned, or be seen in a mirror: the order of the patches is
the one of a rectangle's four that agrees with the chart's reference, and no other comes near it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

ROWS, COLUMNS = 4, 6
NEUTRAL = tuple(range(18, 24))
"""Numbers of the grey patches, the white first."""
TODO = "give the four corners of its patches as --corners X,Y X,Y X,Y X,Y, or picture it larger and in focus"

_INNER = 0.5
"""Measured part of the distance of patches; a patch's edge is about 0.8 of it."""
_FEWEST_PX = 6
_SCALES = (1.0, 2.0, 3.0, 0.5)
_GAMMAS = (2.2, 1.0)
_LOWEST_AGREEMENT, _LEAST_LEAD = 0.85, 0.05
_MEDIAN_EFFICIENCY = np.pi / 2.0
"""Variance of a median over that of a mean, of many normal values."""
_MAD = 1.4826
"""Standard deviation of normal values over their median absolute deviation."""
_TURNS = {
    "upright": (slice(None), slice(None)),
    "turned by 180 deg": (slice(None, None, -1), slice(None, None, -1)),
    "mirrored left to right": (slice(None), slice(None, None, -1)),
    "mirrored upside down": (slice(None, None, -1), slice(None)),
}


@dataclass(frozen=True, eq=False)
class Picture:
    """A merged picture by channel, all channels at the same places.

    Attributes
    ----------
    values : ndarray, shape (H, W, C)
        Radiance in any unit.
    usable : ndarray of bool, shape (H, W, C)
        Neither clipped nor hot.
    px : int
        Pixels of the sensor along a side of one of these: 2 for cells of a colour filter array.
    """

    values: Array
    usable: Bools
    px: int = 1


@dataclass(frozen=True, eq=False)
class ChartReading:
    """The 24 patches, in the order of the chart.

    Attributes
    ----------
    values, u_values : ndarray, shape (24, C)
        Median over the inner part of each patch, and its standard uncertainty from the scatter there.
    counts : ndarray of int, shape (24, C)
        Values that it is of.
    centres_px : ndarray, shape (24, 2)
        Column and row of each patch's centre, in pixels of the sensor.
    order : str
        How the chart lies in the picture: upright, turned, mirrored.
    agreement : float
        Correlation of the logarithms with the reference, channels each about its mean.
    """

    values: Array
    u_values: Array
    counts: NDArray[np.intp]
    centres_px: Array
    order: str
    agreement: float


def picture_of(
    radiance: Array, flags: NDArray[np.integer], cfa: NDArray[np.integer], channels: int, bad: int
) -> Picture:
    """Put a mosaic's cells together: the mean over each channel's sites of a cell.

    Parameters
    ----------
    radiance, flags : ndarray, shape (H, W)
        Of a merge.
    cfa : ndarray of int, shape (2, 2)
        Channel of each site.
    channels : int
        How many there are.
    bad : int
        Flags that make a site unusable.

    Returns
    -------
    Picture
        Of shape (H // 2, W // 2, C).
    """
    rows, columns = (size // 2 * 2 for size in radiance.shape)
    good = ((flags[:rows, :columns] & bad) == 0) & np.isfinite(radiance[:rows, :columns])
    values, usable = [], []
    for channel in range(channels):
        sites = [(row, col) for row in (0, 1) for col in (0, 1) if cfa[row, col] == channel]
        values.append(np.mean([radiance[row:rows:2, col:columns:2] for row, col in sites], axis=0))
        usable.append(np.all([good[row::2, col::2] for row, col in sites], axis=0))
    return Picture(np.stack(values, axis=-1), np.stack(usable, axis=-1), 2)


def read_chart(
    picture: Picture, reference: Array, corners_px: Sequence[tuple[float, float]] | None = None
) -> ChartReading:
    """Find the chart, measure its patches and put them in order.

    Parameters
    ----------
    picture : Picture
        Of C channels.
    reference : ndarray, shape (24, C)
        What the patches should read in each channel, each channel up to a factor.
    corners_px : sequence of four (column, row), optional
        Corners of the field of patches, one after the other around it, in pixels of the sensor; by default
        the chart is looked for.

    Returns
    -------
    ChartReading

    Raises
    ------
    BadInput
        There is no chart, patches are too small or clipped, or their order cannot be told.
    """
    grids = [_given(corners_px, picture.px)] if corners_px is not None else list(_found(picture))
    readings = []
    trouble: BadInput | None = None
    for grid in grids:
        try:
            readings.append(_read(picture, grid, reference))
        except BadInput as error:
            trouble = trouble or error
    if not readings:
        raise trouble or BadInput("no chart of 24 patches is found", where="the picture", todo=TODO)
    return max(readings, key=lambda reading: reading.agreement)


def _given(corners_px: Sequence[tuple[float, float]], px: int) -> Array:
    """Map from the field of patches, columns 0 to 6 and rows 0 to 4, to the picture, (3, 3)."""
    import cv2

    corners = (np.asarray(corners_px, dtype=np.float64) + 0.5) / px - 0.5
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise BadInput("not four corners", where="--corners", todo="write X,Y four times")
    edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if edges[0] + edges[2] < edges[1] + edges[3]:
        corners = np.roll(corners, -1, axis=0)
    field = np.array([[0, 0], [COLUMNS, 0], [COLUMNS, ROWS], [0, ROWS]], dtype=np.float32)
    if abs(_area(corners)) < ROWS * COLUMNS:
        raise BadInput("corners that span no area", where="--corners", todo="go around the field of patches")
    return np.asarray(cv2.getPerspectiveTransform(field, corners.astype(np.float32)), dtype=np.float64)


def _area(corners: Array) -> float:
    x, y = corners.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _found(picture: Picture) -> Iterator[Array]:
    """Map the field of patches to the picture: once for each preview in which the chart is seen."""
    import cv2

    for preview, scale in _previews(picture):
        detector = cv2.mcc.CCheckerDetector_create()  # type: ignore[attr-defined]
        if not detector.process(preview, cv2.mcc.MCC24, 1):
            continue
        quads = np.asarray(detector.getBestColorChecker().getColorCharts(), dtype=np.float64)
        centres = (quads.reshape(-1, 4, 2).mean(axis=1) + 0.5) / scale - 0.5
        if centres.shape != (ROWS * COLUMNS, 2):
            continue
        grid, _ = cv2.findHomography(_centres(), centres)
        if grid is not None:
            yield np.asarray(grid, dtype=np.float64)


def _previews(picture: Picture) -> Iterator[tuple[NDArray[np.uint8], float]]:
    """Pictures of eight bits, each channel's 99.5th percentile at white."""
    import cv2

    values = np.nan_to_num(picture.values)
    planes = values if values.shape[2] == 3 else np.repeat(values.mean(axis=2, keepdims=True), 3, axis=2)
    level = planes / np.maximum(np.percentile(planes, 99.5, axis=(0, 1)), np.finfo(float).tiny)
    for gamma in _GAMMAS:
        shown = np.rint(255.0 * np.clip(level, 0.0, 1.0) ** (1.0 / gamma)).astype(np.uint8)
        for scale in _SCALES:
            how = cv2.INTER_CUBIC if scale > 1.0 else cv2.INTER_AREA
            # OpenCV's channels begin with blue.
            yield cv2.resize(shown[..., ::-1], None, fx=scale, fy=scale, interpolation=how), scale


def _centres() -> Array:
    """Centres of the patches on the field, in the order of rows, (24, 2)."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    return np.stack([column.ravel() + 0.5, row.ravel() + 0.5], axis=1)


def _read(picture: Picture, grid: Array, reference: Array) -> ChartReading:
    values, u_values, counts = _patches(picture, grid)
    places = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    orders = {name: places[turn].ravel() for name, turn in _TURNS.items()}
    agreements = {name: _agreement(values[order], reference) for name, order in orders.items()}
    name, rival = sorted(agreements, key=lambda each: -agreements[each])[:2]
    if agreements[name] < _LOWEST_AGREEMENT or agreements[name] - agreements[rival] < _LEAST_LEAD:
        what = f"patches agree to {agreements[name]:.2f}, {name}, and {agreements[rival]:.2f}, {rival}"
        raise BadInput(f"{what}: no order", where="the chart", todo=TODO)
    order = orders[name]
    centres = _mapped(grid, _centres())[order]
    return ChartReading(
        values[order],
        u_values[order],
        counts[order],
        (centres + 0.5) * picture.px - 0.5,
        _lies(centres),
        agreements[name],
    )


def _lies(centres: Array) -> str:
    """Say how a chart lies, of which the patches' centres (24, 2) are known."""
    along, down = centres[COLUMNS - 1] - centres[0], centres[-COLUMNS] - centres[0]
    mirrored = along[0] * down[1] < along[1] * down[0]
    quarter = 90.0 * np.rint(np.degrees(np.arctan2(along[1], along[0])) / 90.0)
    turned = f"turned by {abs(quarter):.0f} deg" if quarter else "upright"
    return f"{turned}, mirrored" if mirrored else turned


def _patches(picture: Picture, grid: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Median, its standard uncertainty and count of each patch's inner part, (24, C) each."""
    height, width, channels = picture.values.shape
    column, row = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    on_field = _mapped(
        np.asarray(np.linalg.inv(grid), dtype=np.float64), np.stack([column.ravel(), row.ravel()], axis=1)
    )
    cell = np.floor(on_field)
    inner = np.all(np.abs(on_field - cell - 0.5) <= 0.5 * _INNER, axis=1)
    inner &= np.all((cell >= 0.0) & (cell < (COLUMNS, ROWS)), axis=1)
    number = np.where(inner, cell[:, 1] * COLUMNS + cell[:, 0], -1.0).astype(np.intp)
    values, usable = picture.values.reshape(-1, channels), picture.usable.reshape(-1, channels)
    found = np.empty((3, ROWS * COLUMNS, channels))
    for patch in range(ROWS * COLUMNS):
        inside = number == patch
        if np.count_nonzero(inside) < _FEWEST_PX:
            raise BadInput(
                f"patch {patch + 1} covers {np.count_nonzero(inside)} values", where="the chart", todo=TODO
            )
        for channel in range(channels):
            some = values[inside & usable[:, channel], channel]
            if 2 * some.size < np.count_nonzero(inside):
                what = f"most of patch {patch + 1} is clipped or hot"
                raise BadInput(what, where="the chart", todo="expose it shorter, or light it evenly")
            median = np.median(some)
            spread = _MAD * np.median(np.abs(some - median))
            found[:, patch, channel] = median, spread * np.sqrt(_MEDIAN_EFFICIENCY / some.size), some.size
    return found[0], found[1], found[2].astype(np.intp)


def _mapped(grid: Array, points: Array) -> Array:
    mapped = np.column_stack([points, np.ones(len(points))]) @ grid.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _agreement(values: Array, reference: Array) -> float:
    """Correlation of logarithms, each channel about its mean; -1 where there is none."""
    floor = 1e-3 * np.max(values, axis=0)
    if np.any(floor <= 0.0):
        return -1.0
    measured = np.log(np.maximum(values, floor))
    expected = np.log(np.maximum(reference, 1e-3 * reference.max(axis=0)))
    measured, expected = measured - measured.mean(axis=0), expected - expected.mean(axis=0)
    size = np.linalg.norm(measured) * np.linalg.norm(expected)
    return float(np.sum(measured * expected) / size) if size > 0.0 else -1.0


def levelled(values: Array, reference: Array) -> tuple[Array, Array]:
    """Take uneven light off the patches: a slope of the logarithm along rows and columns of the chart.

    Parameters
    ----------
    values, reference : ndarray, shape (24, C)
        As read, and as they should be, each channel up to a factor.

    Returns
    -------
    values : ndarray, shape (24, C)
        As at the chart's centre.
    slopes : ndarray, shape (2, C)
        Relative change of the light from the chart's left edge to its right one, and from top to bottom.
    """
    from scipy.optimize import least_squares

    place = _centres() / (COLUMNS, ROWS) - 0.5
    ratio = np.log(np.maximum(values, np.finfo(float).tiny) / reference)
    slopes = np.empty((2, values.shape[1]))
    terms = np.column_stack([np.ones(len(place)), place])
    for channel, column in enumerate(ratio.T):

        def apart(plane: Array, column: Array = column) -> Array:
            return np.asarray(terms @ plane - column)

        start = np.linalg.lstsq(terms, column, rcond=None)[0]
        # A patch whose pigment differs from the reference's must not turn the plane.
        slopes[:, channel] = least_squares(apart, start, loss="soft_l1", f_scale=0.05).x[1:]
    return values * np.exp(-(place @ slopes)), np.expm1(slopes)
