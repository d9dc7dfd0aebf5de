"""What a difference of two BRDFs looks like: albedo, and the colour of a sphere.

A sphere under one distant lamp shows a whole plane of directions at once, highlight, flank and grazing rim.
It is shaded in closed form, pixel by pixel, and two pictures are compared in CIE Lab with the colour
difference of CIEDE2000 (Sharma, Wu & Dalal 2005): 1 is just visible side by side, 5 at a glance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rig.angles import spherical_to_direction, unit

Array = NDArray[np.float64]
Reflectance = Callable[[Array, Array], Array]
"""Of directions wi, wo (N, 3) to f_r (N, C) in 1/sr."""

ALBEDO_ANGLES_DEG = (0.0, 30.0, 60.0)
WITHIN_RAD = np.radians(5.0)
"""Samples this near to an angle of incidence count for its albedo."""
CELLS = (6, 12)
"""Cells of a hemisphere, in the square of the sine and in azimuth: all of one projected solid angle."""
COVERED = 0.5
"""Share of cells with samples below which there is no albedo to speak of."""
SPHERE_PX = 64
LAMP = unit(np.array([-0.45, 0.6, 0.65]))
LINEAR_SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
"""IEC 61966-2-1, white D65."""


def albedo_difference(fitted: Array, data: Array, wi: Array, wo: Array) -> dict[str, float]:
    """Compare directional albedo of a model and of samples at 0, 30 and 60 deg.

    Model minus samples is averaged in cells of equal projected solid angle, so that a dense highlight counts
    for what it reflects; cells without samples take the mean of the others. Cells are turned with the light.

    Parameters
    ----------
    fitted, data : ndarray, shape (N, C)
        The model's and the measured f_r in 1/sr; NaN where unused.
    wi, wo : ndarray, shape (N, 3)
        Unit directions.

    Returns
    -------
    dict of str to float
        `albedo_0`, `albedo_30`, `albedo_60`: root of the mean squared difference over the channels; NaN where
        the samples cover less than half of the hemisphere.
    """
    theta_i = np.arctan2(np.hypot(wi[:, 0], wi[:, 1]), wi[:, 2])
    turn = np.arctan2(wo[:, 1], wo[:, 0]) - np.arctan2(wi[:, 1], wi[:, 0])
    rings, sectors = CELLS
    ring = np.minimum((np.hypot(wo[:, 0], wo[:, 1]) ** 2 * rings).astype(np.intp), rings - 1)
    # The two halves beside the plane of incidence are alike.
    sector = np.minimum(np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi) / np.pi * sectors, sectors - 1)
    cell = ring * sectors + sector.astype(np.intp)
    difference = fitted - data
    usable = np.isfinite(difference).all(axis=1)
    found = {}
    for angle_deg in ALBEDO_ANGLES_DEG:
        near = usable & (np.abs(theta_i - np.radians(angle_deg)) <= WITHIN_RAD)
        count = np.bincount(cell[near], minlength=rings * sectors)
        value = np.nan
        if np.count_nonzero(count) >= COVERED * count.size:
            sums = [np.bincount(cell[near], column, count.size) for column in difference[near].T]
            means = np.stack(sums)[:, count > 0] / count[count > 0]
            value = float(np.sqrt(np.mean(np.square(np.pi * means.mean(axis=1)))))
        found[f"albedo_{angle_deg:.0f}"] = value
    return found


def appearance(model: Reflectance, wi: Array, wo: Array, f_r: Array) -> dict[str, float]:
    """Compare a fitted model with its samples by what people see.

    Parameters
    ----------
    model : callable
        The model's BRDF.
    wi, wo : ndarray, shape (N, 3)
        Unit directions.
    f_r : ndarray, shape (N, C)
        Samples in 1/sr, NaN where unused.

    Returns
    -------
    dict of str to float
        As `albedo_difference` and `sphere_delta_e`; the latter NaN where the samples, one or three channels,
        do not cover the hemisphere for any of its angles, so that nothing could be put in their place.
    """
    found = albedo_difference(model(wi, wo), f_r, wi, wo)
    whole = np.isfinite(f_r).all(axis=1)
    if f_r.shape[1] in {1, 3} and np.isfinite(list(found.values())).any():
        return found | sphere_delta_e(model, interpolated(wi[whole], wo[whole], f_r[whole]))
    return found | {"delta_e_mean": np.nan, "delta_e_95": np.nan}


def shaded_sphere(reflectance: Reflectance, size_px: int = SPHERE_PX) -> Array:
    """Shade a sphere seen from +z under a distant lamp from the upper left.

    Parameters
    ----------
    reflectance : callable
        The BRDF.
    size_px : int
        Width of the picture; the sphere fills it.

    Returns
    -------
    ndarray, shape (K, C)
        Radiance of the K pixels on the sphere that the lamp reaches, 1 for a white Lambertian surface that
        faces the lamp.
    """
    at = (np.arange(size_px) + 0.5) / size_px * 2.0 - 1.0
    x, y = (axis.ravel() for axis in np.meshgrid(at, -at))
    inside = np.square(x) + np.square(y) < 1.0
    normal = np.stack([x, y, np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))], axis=1)[inside]
    lit = normal[normal @ LAMP > 0.0]
    across = unit(np.cross(np.array([0.0, 1.0, 0.0]), lit))
    frame = np.stack([across, np.cross(lit, across), lit], axis=1)
    wi, wo = frame @ LAMP, frame @ np.array([0.0, 0.0, 1.0])
    return np.asarray(np.pi * reflectance(wi, wo) * wi[:, 2:])


def sphere_delta_e(first: Reflectance, second: Reflectance, size_px: int = SPHERE_PX) -> dict[str, float]:
    """Compare two materials by the colours of a shaded sphere.

    Parameters
    ----------
    first, second : callable
        BRDFs of one channel (seen as grey) or of three (linear sRGB).
    size_px : int
        Width of the picture.

    Returns
    -------
    dict of str to float
        `delta_e_mean` and `delta_e_95`, mean and 95th percentile of CIEDE2000 over the lit pixels. Highlights
        are cut at twice white, as on a display.
    """
    pictures = [lab(shaded_sphere(each, size_px)) for each in (first, second)]
    difference = ciede2000(*pictures)
    return {"delta_e_mean": float(difference.mean()), "delta_e_95": float(np.quantile(difference, 0.95))}


def lab(linear: Array) -> Array:
    """Turn linear sRGB (K, 3), or grey (K, 1), into CIE Lab (K, 3) for D65; cut to 0 to 2."""
    rgb = np.clip(np.broadcast_to(linear, (len(linear), 3)), 0.0, 2.0)
    ratio = rgb @ LINEAR_SRGB_TO_XYZ.T / LINEAR_SRGB_TO_XYZ.sum(axis=1)
    limit = (6.0 / 29.0) ** 3
    f = np.where(ratio > limit, np.cbrt(ratio), ratio * (29.0 / 6.0) ** 2 / 3.0 + 4.0 / 29.0)
    return np.stack(
        [116.0 * f[:, 1] - 16.0, 500.0 * (f[:, 0] - f[:, 1]), 200.0 * (f[:, 1] - f[:, 2])], axis=1
    )


def encode_srgb(linear: Array) -> Array:
    """Encode linear sRGB for a display, cut to 0 to 1; IEC 61966-2-1."""
    from colour import cctf_encoding

    return np.clip(np.asarray(cctf_encoding(np.clip(linear, 0.0, 1.0), "sRGB"), dtype=np.float64), 0.0, 1.0)


def ciede2000(first: Array, second: Array) -> Array:
    """Colour difference CIEDE2000 of two sets of Lab colours (K, 3); Sharma, Wu & Dalal 2005, eqs. 2-22."""
    chroma = 0.5 * (np.hypot(first[:, 1], first[:, 2]) + np.hypot(second[:, 1], second[:, 2]))
    stretch = 1.0 + 0.5 * (1.0 - np.sqrt(chroma**7 / (chroma**7 + 25.0**7)))
    a1, a2 = first[:, 1] * stretch, second[:, 1] * stretch
    c1, c2 = np.hypot(a1, first[:, 2]), np.hypot(a2, second[:, 2])
    h1, h2 = (np.degrees(np.arctan2(lab[:, 2], a)) % 360.0 for lab, a in ((first, a1), (second, a2)))
    grey = c1 * c2 == 0.0
    turn = (h2 - h1 + 180.0) % 360.0 - 180.0
    # Exactly opposite hues: the formula's convention is +180.
    turn = np.where(grey, 0.0, np.where(turn == -180.0, np.where(h2 > h1, 180.0, -180.0), turn))
    lightness, c_mean = 0.5 * (first[:, 0] + second[:, 0]), 0.5 * (c1 + c2)
    apart, total = np.abs(h1 - h2) > 180.0, h1 + h2
    hue = np.where(apart, np.where(total < 360.0, total + 360.0, total - 360.0), total) * 0.5
    hue = np.radians(np.where(grey, total, hue))
    t = (
        1.0
        - 0.17 * np.cos(hue - np.radians(30.0))
        + 0.24 * np.cos(2.0 * hue)
        + 0.32 * np.cos(3.0 * hue + np.radians(6.0))
        - 0.20 * np.cos(4.0 * hue - np.radians(63.0))
    )
    bend = 30.0 * np.exp(-np.square((np.degrees(hue) - 275.0) / 25.0))
    rotation = -2.0 * np.sqrt(c_mean**7 / (c_mean**7 + 25.0**7)) * np.sin(np.radians(2.0 * bend))
    offset = np.square(lightness - 50.0)
    d_l = (second[:, 0] - first[:, 0]) / (1.0 + 0.015 * offset / np.sqrt(20.0 + offset))
    d_c = (c2 - c1) / (1.0 + 0.045 * c_mean)
    d_h = 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(0.5 * turn)) / (1.0 + 0.015 * c_mean * t)
    return np.asarray(np.sqrt(np.maximum(d_l**2 + d_c**2 + d_h**2 + rotation * d_c * d_h, 0.0)))


def interpolated(wi: Array, wo: Array, f_r: Array) -> Reflectance:
    """Make a BRDF of samples: the inverse-distance mean of the nearest ones.

    Directions are taken as of an isotropic, mirror-symmetric surface, and near the mirror direction distances
    count more, where BRDFs change fastest.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)
        Unit directions.
    f_r : ndarray, shape (N, C)
        In 1/sr.

    Returns
    -------
    callable
    """
    from scipy.spatial import KDTree

    tree = KDTree(_isotropic(wi, wo))

    def reflectance(light: Array, camera: Array) -> Array:
        distance, index = tree.query(_isotropic(light, camera), k=min(4, len(f_r)))
        weight = 1.0 / np.maximum(distance.reshape(len(light), -1), 1e-9)
        values = f_r[index.reshape(len(light), -1)]
        return np.asarray(np.einsum("nk,nkc->nc", weight, values) / weight.sum(axis=1, keepdims=True))

    return reflectance


def _isotropic(wi: Array, wo: Array) -> Array:
    """Coordinates in which near pairs of directions have near values, the same for turned pairs."""
    theta_i = np.arctan2(np.hypot(wi[:, 0], wi[:, 1]), wi[:, 2])
    turn = np.arctan2(wo[:, 1], wo[:, 0]) - np.arctan2(wi[:, 1], wi[:, 0])
    folded = np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi)
    theta_o = np.arctan2(np.hypot(wo[:, 0], wo[:, 1]), wo[:, 2])
    light = spherical_to_direction(theta_i, np.zeros_like(theta_i))
    camera = spherical_to_direction(theta_o, folded)
    half = unit(light + camera)
    tilt = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    return np.column_stack([0.3 * theta_i, 0.3 * camera, 3.0 * np.sqrt(tilt)])
