"""Photon transfer: gain and read noise from pairs of frames of the same scene.

Half the mean squared difference of two frames is their variance over time, whatever the scene looks like,
and that variance is a straight line over the mean signal (Janesick 2007, ch. 5; EMVA 1288 release 4,
section 6.6):

    var(y) = K y + s_read^2 + q^2 / 12

The spatial variance of one frame is never used: it holds the scene, the lens and the pixels' unequal
responses. Means and variances are taken over tiles, so that one frame of an uneven scene gives many points
of the line; a tile's mean variance lies on it exactly, because the line is straight.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

Array = Any

TILE = 16
"""Pixels of one CFA position along a tile's edge."""

LARGEST_FILL = 0.7
"""Part of the range above black up to which points count: well below the clip level, whatever the tile."""

HOTTEST_FILL = 0.9
"""No pixel of a tile that counts is above this part of the range, so that nothing clips."""

_LEAST_PIXELS = 64
_ROUNDS = 4
_DARKEST = 1e-3


@dataclass(frozen=True, eq=False)
class TransferPoints:
    """Means and variances over time of tiles of pixels.

    Attributes
    ----------
    mean_dn : ndarray, shape (N,)
        Mean signal above bias, in DN: light and dark current.
    mean_square_dn2 : ndarray, shape (N,)
        Mean of the pixels' squared signals, in DN^2: an edge of the scene within a tile raises it.
    variance_dn2 : ndarray, shape (N,)
        Variance of one frame over time, in DN^2.
    pixels : ndarray of int, shape (N,)
        Pixels of each tile that count.
    channel : ndarray of int, shape (N,)
        Channel of each tile's filter.
    """

    mean_dn: NDArray[np.float64]
    mean_square_dn2: NDArray[np.float64]
    variance_dn2: NDArray[np.float64]
    pixels: NDArray[np.int64]
    channel: NDArray[np.int64]

    def of(self, channel: int) -> TransferPoints:
        """Points of one channel."""
        return self._each(lambda values: values[self.channel == channel])

    def _each(self, pick: Callable[[NDArray[Any]], NDArray[Any]]) -> TransferPoints:
        return TransferPoints(*(pick(getattr(self, item.name)) for item in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[TransferPoints]) -> TransferPoints:
        """All points of several pairs.

        Raises
        ------
        BadInput
            There are none.
        """
        if not parts:
            raise BadInput("no pairs of frames", todo="give two frames at least of every exposure")
        return cls(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(cls)))


@dataclass(frozen=True)
class PhotonTransfer:
    """The line var = gain * mean + floor.

    Attributes
    ----------
    gain_dn_per_e, u_gain_dn_per_e : float
        K and its standard uncertainty, DN per electron.
    floor_dn2, u_floor_dn2 : float
        Variance without signal, quantisation included, and its standard uncertainty, DN^2.
    covariance : float
        Of both.
    reduced_chi_square : float
        Of the points about the line; where it is above 1, the uncertainties are widened by its root.
    points : int
    quantisation_step_dn : float
    """

    gain_dn_per_e: float
    u_gain_dn_per_e: float
    floor_dn2: float
    u_floor_dn2: float
    covariance: float
    reduced_chi_square: float
    points: int
    quantisation_step_dn: float = 1.0

    @property
    def read_noise_dn(self) -> float:
        """Read noise without quantisation, DN; 0 where rounding explains all of the floor."""
        return float(np.sqrt(max(self.floor_dn2 - self.quantisation_step_dn**2 / 12.0, 0.0)))

    @property
    def u_rounding_dn2(self) -> float:
        """Standard uncertainty of the floor because q^2/12 is not quite what rounding adds, DN^2.

        It adds more or less by where between two codes the level lies, which shows where the noise is below
        half a step: a cosine over that place, of amplitude (4 s^2 + q^2 / pi^2) exp(-2 pi^2 s^2 / q^2)
        (Widrow and Kollar 2008, ch. 4). This is the farthest noise that may have given the floor, over
        sqrt(2).
        """
        square = self.quantisation_step_dn**2
        if square == 0.0:
            return 0.0
        noise2 = square * np.linspace(0.0, 2.0, 2001)
        amplitude = (4.0 * noise2 + square / np.pi**2) * np.exp(-2.0 * np.pi**2 * noise2 / square)
        apart = np.abs(noise2 - (self.floor_dn2 - square / 12.0))
        return float(np.max(apart, where=apart <= amplitude, initial=0.0) / np.sqrt(2.0))

    @property
    def u_read_noise_dn(self) -> float:
        """Standard uncertainty of the read noise, DN; where there is none, the largest it might be."""
        u_variance = float(np.hypot(self.u_floor_dn2, self.u_rounding_dn2))
        return u_variance / (2.0 * max(self.read_noise_dn, float(np.sqrt(u_variance)) / 2.0))


def pair_points(
    first: Array,
    second: Array,
    bias_dn: Array,
    cfa: Array,
    *,
    range_dn: float,
    usable: NDArray[np.bool_] | None = None,
) -> TransferPoints:
    """Reduce two frames of one exposure to points of the photon transfer line.

    A light that differs between the two is taken out: the second is s times as bright as the first, and
    var(second - s first) = K s (1 + s) y + (1 + s^2) floor.

    Parameters
    ----------
    first, second : ndarray, shape (H, W)
        Counts, black included, DN.
    bias_dn : ndarray, shape (H, W), or float
        Level without light and dark current, DN.
    cfa : ndarray of int, shape (2, 2)
        Channel at each position of the cell.
    range_dn : float
        Clip level above black, DN.
    usable : ndarray of bool, shape (H, W), optional
        False for pixels that never count, such as hot ones.

    Returns
    -------
    TransferPoints
        Of the tiles below `LARGEST_FILL` of the range.

    Raises
    ------
    BadInput
        The frames differ in shape.
    """
    if np.shape(first) != np.shape(second):
        what = f"a pair of frames of {np.shape(first)} and {np.shape(second)} pixels"
        raise BadInput(what, todo="give frames of one camera and one crop")
    a, b = np.asarray(first, dtype=np.float64) - bias_dn, np.asarray(second, dtype=np.float64) - bias_dn
    good = np.ones(a.shape, dtype=bool) if usable is None else usable
    below = good & (np.maximum(a, b) < HOTTEST_FILL * range_dn)
    scale = light_scale(a, b, below)
    parts = []
    for row in (0, 1):
        for col in (0, 1):
            cut = np.s_[row::2, col::2]
            tiles = _tiles(a[cut], b[cut], good[cut], scale, range_dn)
            parts.append(TransferPoints(*tiles, np.full(len(tiles[0]), int(cfa[row][col]))))
    return TransferPoints.joined(parts)


def light_scale(first: Array, second: Array, usable: NDArray[np.bool_]) -> float:
    """Light of the second frame over that of the first; 1 where there is too little to tell.

    The noise of the ratio must not enter the difference: frames without light are compared as they are.

    Parameters
    ----------
    first, second : ndarray, shape (H, W)
        Above bias, DN.
    usable : ndarray of bool, shape (H, W)
    """
    a, b = first[usable], second[usable]
    if a.size == 0:
        return 1.0
    noise = float(np.sqrt(np.mean((b - a) ** 2) * a.size))
    total = float(a.sum())
    return float(b.sum()) / total if total > 100.0 * noise else 1.0


def _tiles(
    a: Array, b: Array, good: NDArray[np.bool_], scale: float, range_dn: float
) -> tuple[Array, Array, Array, Array]:
    """Mean, mean square, variance and pixels of the tiles of one position of the cell that can be used."""
    numbers = _tile_sums(good.astype(np.float64))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_a = _tile_sums(np.where(good, a, 0.0)) / numbers
        product = _tile_sums(np.where(good, a * b, 0.0)) / numbers
        square = _tile_sums(np.where(good, (b - scale * a) ** 2, 0.0)) / numbers
    highest = _tile_max(np.where(good, np.maximum(a, b), -np.inf))
    mean = scale * (1.0 + scale) / (1.0 + scale**2) * mean_a
    fine = (numbers >= _LEAST_PIXELS) & (mean < LARGEST_FILL * range_dn) & (highest < HOTTEST_FILL * range_dn)
    # The product of two frames holds no noise over time, the square of one does.
    mean_square = np.maximum(product, mean**2)
    return mean[fine], mean_square[fine], (square / (1.0 + scale**2))[fine], numbers[fine].astype(np.int64)


def _edges(length: int) -> NDArray[np.int64]:
    return np.linspace(0, length, max(length // TILE, 1) + 1).round().astype(np.int64)[:-1]


def _tile_sums(values: Array) -> Array:
    rows = np.add.reduceat(values, _edges(values.shape[0]), axis=0)
    return np.add.reduceat(rows, _edges(values.shape[1]), axis=1)


def _tile_max(values: Array) -> Array:
    rows = np.maximum.reduceat(values, _edges(values.shape[0]), axis=0)
    return np.maximum.reduceat(rows, _edges(values.shape[1]), axis=1)


def fit_transfer(points: TransferPoints, quantisation_step_dn: float = 1.0) -> PhotonTransfer:
    """Fit gain and floor by weighted least squares.

    A tile of n pixels knows its variance to (2 <v^2> + K^3 <y> / 2) / n, means over its pixels: the second
    term is the excess of a Poisson number over a normal one. The weights are those of the line, not of the
    points: points that came out low must not weigh more.

    Parameters
    ----------
    points : TransferPoints
        Without light and with, else the line has no slope.
    quantisation_step_dn : float
        Distance of neighbouring codes.

    Returns
    -------
    PhotonTransfer

    Raises
    ------
    BadInput
        Fewer than three points, or all at one mean, or a slope that is not positive.
    """
    mean, variance = points.mean_dn, points.variance_dn2
    if len(mean) < 3 or np.ptp(mean) <= 0.0:
        what = f"{len(mean)} usable points of variance over mean"
        raise BadInput(what, todo="shoot pairs of flat frames at several exposures, below clipping")
    design = np.column_stack([mean, np.ones_like(mean)])
    signal, square = np.maximum(mean, 0.0), points.mean_square_dn2
    # To begin with, every tile knows its variance to the same part of it, but for the darkest.
    spread = 2.0 * np.maximum(variance, np.median(variance) * _DARKEST) ** 2
    for _ in range(_ROUNDS):
        weights = points.pixels / spread
        inverse = np.linalg.inv(design.T @ (weights[:, np.newaxis] * design))
        solution = inverse @ (design.T @ (weights * variance))
        gain = float(solution[0])
        if gain <= 0.0:
            what = "the variance does not grow with the signal"
            raise BadInput(
                what, todo="give raw, linear frames with light below clipping, two of each exposure"
            )
        floor = max(float(solution[1]), quantisation_step_dn**2 / 12.0)
        spread = 2.0 * (gain**2 * square + 2.0 * gain * floor * signal + floor**2) + 0.5 * gain**3 * signal
    residual = variance - design @ solution
    reduced = float(np.sum(weights * residual**2) / (len(mean) - 2))
    covariance = inverse * max(reduced, 1.0)
    return PhotonTransfer(
        gain_dn_per_e=gain,
        u_gain_dn_per_e=float(np.sqrt(covariance[0, 0])),
        floor_dn2=float(solution[1]),
        u_floor_dn2=float(np.sqrt(covariance[1, 1])),
        covariance=float(covariance[0, 1]),
        reduced_chi_square=reduced,
        points=len(mean),
        quantisation_step_dn=quantisation_step_dn,
    )


def quantisation_step(counts: Array) -> float:
    """Distance of neighbouring codes of integer counts, DN: 4 where twelve bits were stretched to fourteen.

    Parameters
    ----------
    counts : ndarray of integers

    Returns
    -------
    float
        Greatest common divisor of the differences of the codes in use; 1 where one code alone is.
    """
    codes = np.unique(np.asarray(counts))
    return float(np.gcd.reduce(np.diff(codes.astype(np.int64)))) if codes.size > 1 else 1.0
