"""A camera's colour: `calibration/colour.toml`, from a picture of a chart, and what it makes of samples.

BRDFs stay in the camera's own bands. XYZ and sRGB are derived from them by the matrix, which a sum of diffuse
and specular light passes through unchanged; a root polynomial that does better on the chart stands beside it,
for single colours.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.appearance import LINEAR_SRGB_TO_XYZ
from analysis.colour_chart import NEUTRAL, ChartReading, levelled
from analysis.colour_fit import ColourFit, choose_colour, xyz_of_spectra
from analysis.white_calibration import read_text
from rig.errors import BadInput
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from analysis.spectra import Spectrum

Array = NDArray[np.float64]

FORMAT_VERSION = 1
COLOUR_FILE = "colour.toml"
VISIBLE_NM = np.arange(400.0, 701.0, 5.0)
CHART = "BabelColor Average"
"""Reflectances of a ColorChecker, the mean of thirty (Pascale 2006), in colour-science."""

_WHITES = NEUTRAL[:4]
"""Greys that are bright enough to say what a perfect white would read."""
_NARROW_NM, _BROAD_WIDTH_NM = 5.0, 35.0
_BROAD_NM = np.array([600.0, 540.0, 460.0])
"""Of a camera's red, green and blue: enough to tell the order of patches and how even the light is."""
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""Cone responses of the Bradford transform (Lam 1985)."""
_NUMBERS = {"white_xyz": (3,), "matrix": (3, 3)}


@dataclass(frozen=True, eq=False)
class ColourCalibration:
    """What turns a camera's channels into colour.

    Attributes
    ----------
    channels : tuple of str
        Three, in the order of the matrix's columns.
    matrix : ndarray, shape (3, 3)
        From channels, 1 for a perfect white, to XYZ, Y = 1 for a perfect white.
    white_xyz : ndarray, shape (3,)
        XYZ of a perfect white under the lamp.
    lamp : str
        Under which light colours are meant.
    delta_e_mean, delta_e_max : float
        CIEDE2000 of chart patches that were left out of the matrix's fit.
    date, camera : str
        Empty where unknown.
    """

    channels: tuple[str, ...]
    matrix: Array
    white_xyz: Array
    lamp: str
    delta_e_mean: float
    delta_e_max: float
    date: str = ""
    camera: str = ""

    def xyz(self, values: Array) -> Array:
        """XYZ (..., 3) of channels (..., 3); linear, so BRDFs may be given as well as ratios to white."""
        return np.asarray(values @ self.matrix.T)

    def linear_srgb(self, values: Array) -> Array:
        """Linear sRGB (..., 3) of channels (..., 3), the lamp's white at D65 (Bradford)."""
        return self.xyz(values) @ self.xyz_to_linear_srgb().T

    def xyz_to_linear_srgb(self) -> Array:
        """Return the matrix (3, 3) from XYZ under the lamp to linear sRGB."""
        display = LINEAR_SRGB_TO_XYZ.sum(axis=1)
        gains = (_BRADFORD @ display) / (_BRADFORD @ self.white_xyz)
        adapted = np.linalg.inv(_BRADFORD) @ (gains[:, None] * _BRADFORD)
        return np.asarray(np.linalg.inv(LINEAR_SRGB_TO_XYZ) @ adapted)


def attributes_of(folder: Path, channels: Sequence[str]) -> dict[str, Any]:
    """Return what samples carry of a calibration, so that XYZ and sRGB can be derived from them anywhere.

    Parameters
    ----------
    folder : Path
        Of the calibrations.
    channels : sequence of str
        Of the samples; others than the calibration's have no colour.

    Returns
    -------
    dict
        `xyz_of_channels`, `linear_srgb_of_channels` (9 numbers by rows) and `colour_lamp`; empty without a
        calibration.

    Raises
    ------
    BadInput
        Its file cannot be used, or is of other channels.
    """
    path = folder / COLOUR_FILE
    if not path.is_file():
        return {}
    calibration = load_colour(path)
    if tuple(channels) != calibration.channels:
        what = f"is of the channels {', '.join(calibration.channels)}, the samples of {', '.join(channels)}"
        raise BadInput(
            what, where=str(path), todo="calibrate the colours of this camera, or take the file away"
        )
    return {
        "xyz_of_channels": calibration.matrix.ravel(),
        "linear_srgb_of_channels": (calibration.xyz_to_linear_srgb() @ calibration.matrix).ravel(),
        "colour_lamp": calibration.lamp,
    }


@dataclass(frozen=True, eq=False)
class ChartColours:
    """What a chart says of a camera.

    Attributes
    ----------
    values, u_values : ndarray, shape (24, 3)
        Patches, 1 for a perfect white, uneven light taken off, and standard uncertainty.
    slopes : ndarray, shape (2, 3)
        Unevenness of the light that was taken off, along the chart and across, relative.
    reference_xyz : ndarray, shape (24, 3)
    white_xyz : ndarray, shape (3,)
    fits : list of ColourFit
        The one that left-out patches speak for, then the others.
    """

    values: Array
    u_values: Array
    slopes: Array
    reference_xyz: Array
    white_xyz: Array
    fits: list[ColourFit]

    @property
    def matrix(self) -> ColourFit:
        """The fit of degree 1."""
        return next(fit for fit in self.fits if fit.degree == 1)


def reference_reflectance(nm: Array) -> tuple[list[str], Array]:
    """Names and reflectances (24, K) of a ColorChecker's patches; the ends held constant."""
    from colour import SDS_COLOURCHECKERS

    chart = SDS_COLOURCHECKERS[CHART]
    rows = [
        np.interp(nm, each.wavelengths, np.asarray(each.values, dtype=np.float64)) for each in chart.values()
    ]
    return list(chart), np.stack(rows)


def typical_response(nm: Array, bands_nm: Sequence[float] = ()) -> Array:
    """Responses of three channels that nobody has measured, (K, 3), each one's sum 1.

    Parameters
    ----------
    nm : ndarray, shape (K,)
    bands_nm : sequence of three float, optional
        Narrow bands; by default broad ones as of a camera's red, green and blue.

    Raises
    ------
    BadInput
        A band out of the visible.
    """
    for band in bands_nm:
        if not nm[0] <= band <= nm[-1]:
            raise BadInput(f"{band:g} nm is not visible", where="--bands-nm", todo="give 400 to 700 nm")
    centres, width = (np.asarray(bands_nm), _NARROW_NM) if bands_nm else (_BROAD_NM, _BROAD_WIDTH_NM)
    response = np.exp(-0.5 * np.square((nm[:, None] - centres) / width))
    return np.asarray(response / response.sum(axis=0))


def colours_of(
    reading: ChartReading, channel_reference: Array, reflectance: Array, lamp: Spectrum
) -> ChartColours:
    """Fit colour corrections to a chart.

    Parameters
    ----------
    reading : ChartReading
        Of three channels.
    channel_reference : ndarray, shape (24, 3)
        What the patches should read, a perfect white 1: reflectance in the channels' bands.
    reflectance : ndarray, shape (24, K)
        At `VISIBLE_NM`.
    lamp : Spectrum
        Under which colours are wanted.

    Raises
    ------
    BadInput
        Another number of channels than three, or a fit that cannot be done.
    """
    if reading.values.shape[1] != 3:
        what = f"{reading.values.shape[1]} channels"
        raise BadInput(what, where="the picture", todo="colour takes three: a colour camera, or three bands")
    values, slopes = levelled(reading.values, channel_reference)
    white = np.mean(values[list(_WHITES)] / channel_reference[list(_WHITES)], axis=0)
    light = lamp.at(VISIBLE_NM)[:, 0]
    xyz = xyz_of_spectra(VISIBLE_NM, reflectance, light)
    white_xyz = xyz_of_spectra(VISIBLE_NM, np.ones((1, VISIBLE_NM.size)), light)[0]
    u_values = reading.u_values * (values / reading.values)
    return ChartColours(
        values / white,
        u_values / white,
        slopes,
        xyz,
        white_xyz,
        choose_colour(values / white, xyz, white_xyz),
    )


def save_colour(calibration: ColourCalibration, others: list[ColourFit], path: Path) -> None:
    """Write a calibration file, complete or not at all; the other fits stand in it for people to see."""
    import tomli_w

    content: dict[str, Any] = {
        "version": FORMAT_VERSION,
        "channels": list(calibration.channels),
        "matrix": calibration.matrix.tolist(),
        "white_xyz": calibration.white_xyz.tolist(),
        "lamp": calibration.lamp,
        "delta_e_mean": calibration.delta_e_mean,
        "delta_e_max": calibration.delta_e_max,
        "date": calibration.date,
        "camera": calibration.camera,
        "root_polynomial": [
            {
                "degree": fit.degree,
                "delta_e_mean": float(fit.left_out.mean()),
                "delta_e_max": float(fit.left_out.max()),
                "matrix": fit.matrix.tolist(),
            }
            for fit in others
            if fit.degree > 1
        ],
    }
    with whole_file(path) as place:
        place.write_text(tomli_w.dumps(content), encoding="utf-8")


def load_colour(path: Path) -> ColourCalibration:
    """Read a calibration file.

    Raises
    ------
    BadInput
        It is missing, no TOML, or holds impossible values.
    """
    try:
        content = tomllib.loads(read_text(path, "give a colour.toml"))
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"not TOML ({error})", where=str(path), todo="correct the file") from None
    if content.get("version") != FORMAT_VERSION:
        todo = f"this gonio reads version {FORMAT_VERSION}"
        raise BadInput("its version is not known", where=str(path), todo=todo)
    try:
        numbers = {
            name: np.array(content[name], dtype=np.float64).reshape(shape) for name, shape in _NUMBERS.items()
        }
        mean, most = float(content["delta_e_mean"]), float(content["delta_e_max"])
        channels = tuple(str(name) for name in content["channels"])
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(
            f"a value is missing or wrong ({error})", where=str(path), todo="calibrate again"
        ) from None
    finite = all(np.isfinite(each).all() for each in numbers.values()) and math.isfinite(mean + most)
    if not finite or len(channels) != 3 or np.any(numbers["white_xyz"] <= 0.0):
        raise BadInput("impossible values", where=str(path), todo="calibrate again")
    texts = {name: str(content.get(name, "")) for name in ("lamp", "date", "camera")}
    return ColourCalibration(
        channels, numbers["matrix"], numbers["white_xyz"], delta_e_mean=mean, delta_e_max=most, **texts
    )


def markov_prior(nm: Array, spread: float = 0.25, correlation: float = 0.98) -> Array:
    """Covariance (K, K) of smooth reflectances: a first-order Markov process (Pratt & Mancill 1976, eq. 24).

    `correlation` is that of values 5 nm apart.
    """
    apart = np.abs(nm[:, None] - nm[None, :]) / 5.0
    return np.asarray(spread**2 * correlation**apart)


def spectral_estimate(
    values: Array, u_values: Array, response: Array, nm: Array, mean: float = 0.3
) -> tuple[Array, Array]:
    """Estimate reflectances from channels, where the channels' responses are known: the Wiener estimate.

    Parameters
    ----------
    values, u_values : ndarray, shape (N, C)
        Channels, 1 for a perfect white, and standard uncertainties.
    response : ndarray, shape (K, C)
        Sensitivity times the lamp's spectrum, each channel's sum 1.
    nm : ndarray, shape (K,)
    mean : float
        Reflectance that is expected beforehand.

    Returns
    -------
    reflectance, u_reflectance : ndarray, shape (N, K)
        Estimate, and standard uncertainty given the prior (Pratt & Mancill 1976, eqs. 14 and 15).
    """
    prior = markov_prior(nm)
    gain = prior @ response
    found, u_found = [], []
    for value, u_value in zip(values, u_values, strict=True):
        inside = response.T @ gain + np.diag(np.square(u_value))
        weights = np.linalg.solve(inside, gain.T).T
        found.append(mean + weights @ (value - mean * response.sum(axis=0)))
        u_found.append(np.sqrt(np.maximum(np.diag(prior - weights @ gain.T), 0.0)))
    return np.array(found), np.array(u_found)
