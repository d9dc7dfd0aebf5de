"""What a reduction takes out of the images besides noise: flat field, stray light, lamp drift, the lens.

Each correction has a name, a column of the uncertainty and a switch. One that is switched off leaves its
whole effect in f_r, as an error of unknown part: the column is then as large as the effect.

Stray light adds to every picture at a pose what does not come from the centre by the straight way. A light
trap of reflectance rho_t in the sample's place shows T = t + rho_t k, where t is the stray light and k what a
perfect diffuser would add; with the white's W = t + rho_w k,

    t = (T - q W) / (1 - q),   q = rho_t / rho_w,

and an error of rho_t moves f_r by d(rho_t) / pi (1 - pi f_r / rho_w): nothing for a sample that is as bright
as the white, most for a black one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from capture.clip import RAMP_START
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from analysis.binning import PixelSignals
    from analysis.measurement import Image, Mosaic, PoseImages
    from capture.linearity import Bend
    from capture.sensor import SensorModel
    from rig.description import Rig

    Float = NDArray[np.float64]


class Correction(StrEnum):
    """What can be left out with `gonio reduce --without`."""

    FLAT_FIELD = "flat-field"
    """The white divides pixel by pixel: lens, vignetting and the pixels' inequality cancel. Column u_flat."""

    STRAY_LIGHT = "stray-light"
    """The light trap's pictures are subtracted, where a session has them. Column u_stray."""

    LAMP_DRIFT = "lamp-drift"
    """The lamp's light between white and sample, by its photodiode. Column u_lamp."""

    LENS_DISTORTION = "lens-distortion"
    """The lens model of the rig file, where it has one, for the directions of pixels. Column u_distortion."""

    LINEARITY = "linearity"
    """The sensor's bent response, where its calibration has found one. Column u_linearity."""


def corrections_named(names: Iterable[str], where: str = "--without") -> tuple[Correction, ...]:
    """Read names of corrections, each text one or several with commas between.

    Parameters
    ----------
    names : iterable of str
    where : str
        What to call them in an error.

    Returns
    -------
    tuple of Correction
        Each once, in the order of `Correction`.

    Raises
    ------
    BadInput
        A name is none of a correction.
    """
    given = {name.strip() for text in names for name in text.split(",")}
    known = ", ".join(Correction)
    unknown = sorted(given - set(Correction))
    if unknown:
        raise BadInput(f"no correction is named {unknown[0]!r}", where=where, todo=f"they are {known}")
    return tuple(correction for correction in Correction if correction in given)


def straightened(radiance: Float, exposure_s: Sequence[float], bend: Bend) -> Float:
    """Take a bent response out of a merged image.

    A merge is nearly sum y_i / sum t_i over the frames that do not clip, so the bends of its counts y_i weigh
    as their exposures do.

    Parameters
    ----------
    radiance : (H, W) float
        Counts per second above black.
    exposure_s : sequence of float
        Of the frames that were merged.
    bend : Bend

    Returns
    -------
    (H, W) float
        How many times more light there was: 1 near nought.
    """
    total, seconds = np.zeros_like(radiance), np.zeros_like(radiance)
    for number, exposure in enumerate(sorted(exposure_s)):
        signal = radiance * exposure
        used = np.ones(radiance.shape) if number == 0 else (signal < RAMP_START * bend.range_dn).astype(float)
        total += used * exposure * bend.of(signal)
        seconds += used * exposure
    return np.asarray(seconds / total)


def u_linearity_of(sensor: SensorModel | None, *, corrected: bool) -> float | None:
    """Relative uncertainty of f_r by a response that is not quite straight; None where it is not known.

    Sample and white are counted at different levels, each off by its own deviation: sqrt(2) of their standard
    deviation, which is sqrt(pi / 2) of the mean absolute one where they are normal.
    """
    if sensor is None:
        return None
    if sensor.response is not None:
        left_in = 0.0 if corrected else sensor.response.spread
        return math.hypot(sensor.response.error, left_in) * math.sqrt(2.0)
    return None if sensor.linearity_error is None else sensor.linearity_error * math.sqrt(math.pi)


@dataclass(frozen=True)
class Stray:
    """Stray light at one pose.

    Attributes
    ----------
    on_sample, on_white : (H, W) float or float
        What it adds to either image, in their unit.
    variance : (H, W) float or float
        Of either, by the trap's noise.
    u_trap : float
        Standard uncertainty of the trap's reflectance.
    u_relative : float
        Of the stray light, where it was not seen at this pose.
    """

    on_sample: Float | float = 0.0
    on_white: Float | float = 0.0
    variance: Float | float = 0.0
    u_trap: float = 0.0
    u_relative: float = 0.0


def stray_light(rig: Rig, images: PoseImages, rho_white: Float) -> Stray | None:
    """Stray light at a pose, None where no light trap was seen.

    Parameters
    ----------
    rig : Rig
        Says how black its trap is.
    images : PoseImages
    rho_white : (H, W) float
        The white's reflectance factor at each pixel.
    """
    if images.trap is None:
        return None
    trap, white = images.trap, images.white
    with np.errstate(invalid="ignore", divide="ignore"):
        share = rig.trap.rho / rho_white
        seen = trap.radiance * _light_over(white, trap)
        on_white = (seen - share * white.radiance) / (1.0 - share)
    return Stray(
        on_sample=on_white * _light_over(images.sample, white),
        on_white=on_white,
        variance=trap.variance,
        u_trap=rig.trap.u_rho,
        u_relative=images.u_trap,
    )


def _light_over(image: Image, other: Image) -> float:
    """Give the lamp's light in one image over that in another; 1 where it was not measured."""
    ratio = image.lamp_output / other.lamp_output
    return ratio if math.isfinite(ratio) else 1.0


def stray_as_f(stray: Stray, pixels: PixelSignals, mosaic: Mosaic) -> Float:
    """Express stray light on the sample as the f_r of a surface that would look so bright, (C,) 1/sr.

    Parameters
    ----------
    stray : Stray
    pixels : PixelSignals
        Of the pose.
    mosaic : Mosaic
    """
    found = np.zeros(len(mosaic.names))
    light = np.broadcast_to(stray.on_sample, pixels.signal.shape)
    for index in range(len(found)):
        mine = pixels.usable & (mosaic.channel == index)
        reference = float(np.sum(pixels.reference[mine]))
        found[index] = float(np.sum(light[mine])) / reference if reference > 0.0 else 0.0
    return found


def u_stray_of(f_r: Float, rho_white: Float, stray: Stray, stray_f: Float, *, corrected: bool) -> Float:
    """Uncertainty of f_r by stray light, 1/sr.

    Parameters
    ----------
    f_r : (N, C) float
    rho_white : (N, C) float
        The white's reflectance factor.
    stray : Stray
    stray_f : (C,) float
        The stray light, as the f_r of a surface that would look so bright.
    corrected : bool
        Whether it was taken out.
    """
    contrast = np.abs(1.0 - math.pi * f_r / rho_white)
    left = stray.u_relative if corrected else 1.0
    return np.asarray(contrast * np.hypot(stray.u_trap / math.pi, left * np.abs(stray_f)))


def lamp_drift(rig: Rig, images: PoseImages, *, correct: bool) -> tuple[float, float]:
    """Light on the sample over that on the white, as far as it is taken out, and what is left uncertain.

    Without readings of both nothing is known, and nothing is stated.
    """
    ratio = images.sample.lamp_output / images.white.lamp_output
    if not math.isfinite(ratio):
        return 1.0, 0.0
    return (ratio, rig.lamp.u_monitor) if correct else (1.0, math.hypot(ratio - 1.0, rig.lamp.u_monitor))


def flattened(
    rig: Rig, pixels: PixelSignals, mosaic: Mosaic, *, correct: bool
) -> tuple[PixelSignals, Float | float]:
    """Keep the flat field that the white shows, or make it even.

    Parameters
    ----------
    rig : Rig
    pixels : PixelSignals
        With the white's flat field.
    mosaic : Mosaic
    correct : bool
        Whether it stays.

    Returns
    -------
    pixels : PixelSignals
    u_relative : float or (C,) float
        What is left uncertain: corrected, what the white's plate itself is uneven by.
    """
    if correct:
        return pixels, rig.white.u_uniformity
    with np.errstate(invalid="ignore", divide="ignore"):
        even, variance, unevenness = _without_flat_field(
            pixels.reference / pixels.weight,
            pixels.reference_variance / pixels.weight**2,
            pixels.usable,
            mosaic.channel,
        )
    left = replace(pixels, reference=even * pixels.weight, reference_variance=variance * pixels.weight**2)
    return left, unevenness


def _without_flat_field(
    reference: Float, variance: Float, usable: NDArray[np.bool_], channel: NDArray[np.intp]
) -> tuple[Float, Float, Float]:
    """Replace the white's picture by its mean over each channel: one factor for the whole frame.

    Parameters
    ----------
    reference, variance : (H, W) float
        What each pixel would read from a surface of f = 1/sr under the irradiance at the frame's pixels,
        divided by that irradiance; and its variance.
    usable : (H, W) bool
        Pixels that count.
    channel : (H, W) int

    Returns
    -------
    reference, variance : (H, W) float
        Even over each channel.
    unevenness : (C,) float
        Relative standard deviation that was there, without noise.
    """
    even, even_variance = np.array(reference), np.array(variance)
    unevenness = np.zeros(int(channel.max(initial=0)) + 1)
    for index in range(len(unevenness)):
        mine = channel == index
        pixels = mine & usable
        count = np.count_nonzero(pixels)
        if not count:
            continue
        mean = float(np.mean(reference[pixels]))
        noise = float(np.mean(variance[pixels]))
        even[mine], even_variance[mine] = mean, noise / count
        excess = max(float(np.var(reference[pixels])) - noise, 0.0)
        unevenness[index] = math.sqrt(excess) / abs(mean) if mean else 0.0
    return even, even_variance, unevenness
