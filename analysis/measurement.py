"""The measurement equation for one pose: merged images and geometry to f_r with its uncertainty columns.

For pixel p, with S the sample's radiance, W the white's, E the irradiance on the plane and V whatever the
camera does to that pixel (vignetting, gain), S = f_s E_s V and W = (rho_w / pi) E_w V, so

    f_s = S / X,   X = W (pi / rho_w) (E_s / E_w),

where E = (d / r)^2 cos(theta_i) is the small lamp's irradiance from the pixel's own geometry (Nicodemus et
al. 1977 for f_r = dL / dE). Where the lamp's photodiode was read for both images, X is also multiplied by the
light's ratio L_s / L_w. V cancels because both images come from the same pixel. Stray light, where a light
trap showed it, is subtracted from both (`analysis.corrections`). Bins take ratios of sums of S and X
(`analysis.binning`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.binning import Dropped, PixelSignals, bin_ratio, curvature, make_bins
from analysis.corrections import (
    Correction,
    Stray,
    flattened,
    lamp_drift,
    stray_as_f,
    stray_light,
    u_stray_of,
)
from analysis.lens import is_bent, straight_lens, u_distortion_of
from capture.merge import Flag
from rig.pixels import irradiance, pixel_direction_derivatives, pixel_geometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.binning import Bins
    from analysis.white import WhiteReference
    from rig.description import Rig
    from rig.pixels import PixelGeometry

    Float = NDArray[np.float64]
    Int = NDArray[np.intp]

UNUSABLE = Flag.OVER_RANGE | Flag.NEAR_CLIPPED_USED | Flag.HOT | Flag.INCONSISTENT
"""Flags that keep a pixel out of a bin. Under-range pixels stay: to drop the dark raises every dark bin."""

STEP_RAD = 1e-4
"""Step of the central difference of irradiance over a joint's angle."""


@dataclass(frozen=True)
class Options:
    """What a person may choose about a reduction.

    Attributes
    ----------
    bin_px : int
        Edge of the square bins, pixels; even, so that every bin holds whole colour quads.
    min_fill : float
        Fraction of a channel's pixels in a bin that must be usable, 0 to 1.
    edge_margin_mm : float
        Rim of the sample that is left out: chipped edges, and the pose's own uncertainty.
    max_theta_deg : float
        Pixels seen or lit from beyond this angle from the normal are left out.
    without : tuple of Correction
        What is not corrected; its effect is part of the uncertainty instead.
    """

    bin_px: int = 8
    min_fill: float = 0.5
    edge_margin_mm: float = 0.5
    max_theta_deg: float = 85.0
    without: tuple[Correction, ...] = ()

    def corrects(self, correction: Correction) -> bool:
        """Whether a correction is made."""
        return correction not in self.without


@dataclass(frozen=True)
class Image:
    """One merged image and the pose it was taken at.

    Attributes
    ----------
    radiance, variance : (H, W) float
        Counts per second above black, and their variance.
    flags : (H, W) int
        Bits of `capture.merge.Flag`.
    angles_rad : (J,) float
        Measured angles of the arms' joints, in the order of `rig.arm_joints`.
    lamp_output : float
        Light over what the lamp's level promises; NaN where it was not measured.
    """

    radiance: Float
    variance: Float
    flags: NDArray[np.integer]
    angles_rad: Float
    lamp_output: float = math.nan


@dataclass(frozen=True)
class PoseImages:
    """The merged images of one pose.

    Attributes
    ----------
    sample, white : Image
        Taken at the same pose, or a few encoder steps apart.
    trap : Image or None
        The light trap, which shows the stray light in both.
    u_trap : float
        Relative uncertainty of that image where it was put together from those of other poses.
    """

    sample: Image
    white: Image
    trap: Image | None = None
    u_trap: float = 0.0


@dataclass(frozen=True)
class Mosaic:
    """Which colour channel each pixel sees.

    Attributes
    ----------
    channel : (H, W) int
        Index into `names`.
    names : tuple of str
        The channels, for example R, G, B.
    """

    channel: Int
    names: tuple[str, ...]

    @classmethod
    def repeat(cls, cfa: NDArray[np.integer], names: tuple[str, ...], shape: tuple[int, int]) -> Mosaic:
        """Repeat a colour filter's period `cfa` (h, w) over an image of `shape`."""
        rows, cols = (np.arange(n) % period for n, period in zip(shape, cfa.shape, strict=True))
        return cls(np.asarray(cfa, dtype=np.intp)[np.ix_(rows, cols)], names)


@dataclass(frozen=True)
class PoseSamples:
    """The samples of one pose; N samples, C channels, J joints.

    Attributes
    ----------
    wi, wo : (N, 3) float
        Unit directions to light and camera, sample frame.
    f_r : (N, C) float
        BRDF, 1/sr; NaN where `dropped` is not zero.
    u_noise, u_white, u_reference, u_binning, u_lamp, u_flat : (N, C) float
        Standard uncertainty columns, 1/sr: the sample's noise, the white's, the white's reflectance, the
        bin's size, the lamp's drift between white and sample, the flat field.
    u_stray : (N, C) float or None
        The stray light's; None where no light trap told of it.
    u_distortion : (N, C) float or None
        The lens's; None where the rig file gives it no distortion.
    dropped : (N, C) int
        Bits of `analysis.binning.Dropped`.
    bin_index : (N,) int
        The bin's number in the layout.
    d_wi, d_wo : (N, J, 3) float
        Change of the directions per radian of each joint.
    pixel_flags : dict of str to int
        How many of the sample's on-sample pixels carry each flag.
    bins_dropped : dict of str to int
        How many channel values were dropped for each reason, out of bins that saw the sample.
    """

    wi: Float
    wo: Float
    f_r: Float
    u_noise: Float
    u_white: Float
    u_reference: Float
    u_binning: Float
    u_lamp: Float
    u_flat: Float
    u_stray: Float | None
    u_distortion: Float | None
    dropped: Int
    bin_index: Int
    d_wi: Float
    d_wo: Float
    pixel_flags: dict[str, int]
    bins_dropped: dict[str, int]


def reduce_pose(
    rig: Rig,
    images: PoseImages,
    mosaic: Mosaic,
    reference: WhiteReference,
    *,
    u_joint_rad: Float,
    options: Options | None = None,
) -> PoseSamples:
    """Reduce one pose to BRDF samples.

    Parameters
    ----------
    rig : Rig
        The machine: distances, camera, sample.
    images : PoseImages
        Sample, white and possibly the light trap at the pose.
    mosaic : Mosaic
        The colour filter.
    reference : WhiteReference
        The white's reflectance.
    u_joint_rad : (J,) float
        Standard uncertainty of the joints' angles. It enters here only where white and sample were not taken
        at the same joint angles, so that their irradiances do not share an error; else it acts through `d_wi`
        and `d_wo`.
    options : Options, optional
        Bin size, margins.

    Returns
    -------
    PoseSamples
        The bins that have a value in at least one channel.
    """
    options = options or Options()
    lens, straight = rig, options.corrects(Correction.LENS_DISTORTION)
    if not straight:
        rig = straight_lens(rig)
    sample, white = images.sample, images.white
    height, width = sample.radiance.shape
    bins = make_bins(height, width, options.bin_px)
    sample_geometry = pixel_geometry(rig, sample.angles_rad)
    same_pose = np.array_equal(sample.angles_rad, white.angles_rad)
    white_geometry = sample_geometry if same_pose else pixel_geometry(rig, white.angles_rad)
    geometries = (sample_geometry, white_geometry)
    seen = np.logical_and.reduce([_well_seen(rig, geometry, options) for geometry in geometries])
    drift, u_drift = lamp_drift(rig, images, correct=options.corrects(Correction.LAMP_DRIFT))
    to_unit_f, rho_white, e_sample = _to_unit_f(rig, geometries, reference, mosaic.channel)
    stray = stray_light(rig, images, rho_white)
    taken_out = stray if stray is not None and options.corrects(Correction.STRAY_LIGHT) else Stray()
    pixels = _signals(images, geometries, (to_unit_f * drift, e_sample), seen, taken_out)
    pixels, u_flat = flattened(rig, pixels, mosaic, correct=options.corrects(Correction.FLAT_FIELD))
    binned = bin_ratio(pixels, bins, mosaic.channel, len(mosaic.names), min_fill=options.min_fill)
    u_geometry = 0.0 if same_pose else _irradiance_uncertainty(rig, images, bins, u_joint_rad)
    u_binning = curvature(binned.ratio, binned.u_signal**2 + binned.u_reference**2, bins.shape)
    kept = np.flatnonzero((binned.dropped == 0).any(axis=1))
    d_wi, d_wo = _direction_derivatives(rig, sample.angles_rad, bins)
    ratio, wi, wo = binned.ratio[kept], binned.wi[kept], binned.wo[kept]
    everywhere = (wi[:, np.newaxis], wo[:, np.newaxis], np.arange(len(mosaic.names)))
    rho = reference.rho(*everywhere)
    relative_reference = reference.u_rho(*everywhere) / rho
    u_stray = None
    if stray is not None:
        stray_f = stray_as_f(stray, pixels, mosaic)
        corrected = options.corrects(Correction.STRAY_LIGHT)
        u_stray = u_stray_of(ratio, rho, stray, stray_f, corrected=corrected)
    u_distortion = None
    if is_bent(lens):
        u_distortion = u_distortion_of(lens, binned.ratio, bins, options.bin_px, corrected=straight)[kept]
    return PoseSamples(
        wi=wi,
        wo=wo,
        f_r=ratio,
        u_noise=binned.u_signal[kept],
        u_white=np.hypot(binned.u_reference, np.abs(binned.ratio) * u_geometry)[kept],
        u_reference=np.abs(ratio) * relative_reference,
        u_binning=np.where(np.isfinite(ratio), u_binning[kept], np.nan),
        u_lamp=np.abs(ratio) * u_drift,
        u_flat=np.abs(ratio) * u_flat,
        u_stray=u_stray,
        u_distortion=u_distortion,
        dropped=binned.dropped[kept],
        bin_index=kept,
        d_wi=d_wi[kept],
        d_wo=d_wo[kept],
        pixel_flags=_count_flags(sample.flags[sample_geometry.on_sample]),
        bins_dropped=_count_dropped(binned.dropped, binned.pixels),
    )


def _to_unit_f(
    rig: Rig,
    geometries: tuple[PixelGeometry, PixelGeometry],
    reference: WhiteReference,
    channel: Int,
) -> tuple[Float, Float, Float]:
    """Factor from the white to what f = 1/sr would signal, the white's rho, the irradiance on the sample."""
    white = geometries[1]
    e_sample, e_white = (irradiance(rig, geometry) for geometry in geometries)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = reference.rho(white.wi, white.wo, channel)
        return np.pi / rho * e_sample / e_white, rho, e_sample


def _signals(
    images: PoseImages,
    geometries: tuple[PixelGeometry, PixelGeometry],
    factors: tuple[Float, Float],
    seen: NDArray[np.bool_],
    stray: Stray,
) -> PixelSignals:
    """Put one pose's pixels into the form that binning takes."""
    sample, white, trap = images.sample, images.white, images.trap
    to_unit_f, e_sample = factors
    taken = [sample, white] if trap is None else [sample, white, trap]
    flags = np.bitwise_or.reduce([image.flags for image in taken])
    finite = np.logical_and.reduce([np.isfinite(image.radiance + image.variance) for image in taken])
    clipped = (flags & Flag.OVER_RANGE).astype(bool) & ~(flags & Flag.HOT).astype(bool)
    return PixelSignals(
        signal=sample.radiance - stray.on_sample,
        signal_variance=sample.variance + stray.variance,
        reference=(white.radiance - stray.on_white) * to_unit_f,
        reference_variance=(white.variance + stray.variance) * to_unit_f**2,
        weight=e_sample,
        usable=seen & finite & ~(flags & UNUSABLE).astype(bool),
        clipped=seen & clipped,
        wi=geometries[0].wi,
        wo=geometries[0].wo,
    )


def _well_seen(rig: Rig, geometry: PixelGeometry, options: Options) -> NDArray[np.bool_]:
    """Pixels whose patch lies on the sample, off its rim, lit and seen away from grazing."""
    lowest = np.cos(np.deg2rad(options.max_theta_deg))
    radius = np.hypot(geometry.position_mm[..., 0], geometry.position_mm[..., 1])
    with np.errstate(invalid="ignore"):
        inner = radius <= rig.sample.diameter_mm / 2 - options.edge_margin_mm
        steep = (geometry.wi[..., 2] >= lowest) & (geometry.wo[..., 2] >= lowest)
    seen: NDArray[np.bool_] = geometry.on_sample & inner & steep
    return seen


def _direction_derivatives(rig: Rig, angles_rad: Float, bins: Bins) -> tuple[Float, Float]:
    """Give the change of the directions at the bins' centres, (B, J, 3) each, per radian of each joint."""
    rows, cols = bins.centres_px()
    derivatives = pixel_direction_derivatives(rig, angles_rad, rows=rows, cols=cols)
    d_wi, d_wo = (np.moveaxis(values, 0, 2).reshape(bins.count, -1, 3) for values in derivatives)
    return d_wi, d_wo


def _irradiance_uncertainty(rig: Rig, images: PoseImages, bins: Bins, u_joint_rad: Float) -> Float:
    """Relative uncertainty (B, 1) of E_s / E_w from joints that moved between white and sample."""
    rows, cols = bins.centres_px()
    poses = (images.sample.angles_rad, images.white.angles_rad)
    variance = np.zeros(bins.count)
    for joint in np.flatnonzero(poses[0] != poses[1]):
        step = np.zeros_like(u_joint_rad)
        step[joint] = STEP_RAD
        for angles_rad in poses:
            after, before = (
                irradiance(rig, pixel_geometry(rig, angles_rad + sign * step, rows=rows, cols=cols)).ravel()
                for sign in (1, -1)
            )
            with np.errstate(invalid="ignore", divide="ignore"):
                slope = (np.log(after) - np.log(before)) / (2 * STEP_RAD)
            variance += (slope * u_joint_rad[joint]) ** 2
    relative: Float = np.sqrt(variance)[:, None]
    return relative


def _count_flags(flags: NDArray[np.integer]) -> dict[str, int]:
    return {str(flag.name).lower(): int(np.count_nonzero(flags & flag)) for flag in Flag}


def _count_dropped(dropped: Int, pixels: Int) -> dict[str, int]:
    on_sample = pixels.any(axis=1)
    return {
        str(reason.name).lower(): int(np.count_nonzero(dropped[on_sample] & reason)) for reason in Dropped
    }
