"""From a model's channels to linear sRGB: as named, or by the colour matching of their wavelengths."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.appearance import LINEAR_SRGB_TO_XYZ
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

FINE_NM = np.arange(380.0, 781.0, 1.0)
NEEDED_NM = (460.0, 620.0)
"""Wavelengths that a spectrum must reach to have a colour."""

WAVELENGTH = re.compile(r"\A(\d+(?:\.\d+)?) ?nm\Z")

LOBES = {
    "x": ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2)),
    "y": ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1)),
    "z": ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8)),
}
"""CIE 1931 as sums of lobes: height, centre and widths in nm (Wyman, Sloan & Shirley 2013, table 1)."""


def to_linear_srgb(channels: Sequence[str]) -> Array:
    """Return the matrix (C, 3) that takes values by channel to linear sRGB.

    A spectrum is weighted as under light of equal energy, and scaled so that what reflects alike at all
    wavelengths is grey.

    Raises
    ------
    BadInput
        If the channels are neither one, nor R, G, B, nor X, Y, Z, nor wavelengths over the visible range.
    """
    names = [name.upper() for name in channels]
    if len(names) == 1:
        return np.ones((1, 3))
    if names == ["R", "G", "B"]:
        return np.eye(3)
    if names == ["X", "Y", "Z"]:
        return np.asarray(np.linalg.inv(LINEAR_SRGB_TO_XYZ).T)
    wavelengths = [WAVELENGTH.match(name) for name in channels]
    if all(wavelengths):
        return _of_spectrum(np.array([float(match[1]) for match in wavelengths if match]))
    raise BadInput(
        f"channels {', '.join(channels[:4])} are no colour",
        where="export",
        todo="choose one channel, or name them R, G, B, or wavelengths such as 550nm",
    )


def _of_spectrum(wavelength_nm: Array) -> Array:
    low, high = float(wavelength_nm.min()), float(wavelength_nm.max())
    if wavelength_nm.size < 3 or low > NEEDED_NM[0] or high < NEEDED_NM[1]:
        raise BadInput(
            f"{wavelength_nm.size} wavelengths from {low:g} to {high:g} nm are no colour",
            where="export",
            todo=f"choose one, or at least 3 that reach from {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm",
        )
    order = np.argsort(wavelength_nm)
    # Each wavelength's share of the fine grid, the ends held constant.
    shares = np.stack([np.interp(FINE_NM, wavelength_nm[order], row) for row in np.eye(order.size)])
    matching = np.stack([sum(_lobe(*lobe) for lobe in LOBES[name]) for name in "xyz"], axis=1)
    xyz = np.empty((order.size, 3))
    xyz[order] = shares @ matching
    white = LINEAR_SRGB_TO_XYZ.sum(axis=1)
    xyz *= white / xyz.sum(axis=0)
    return np.asarray(xyz @ np.linalg.inv(LINEAR_SRGB_TO_XYZ).T)


def _lobe(height: float, centre: float, below: float, above: float) -> Array:
    width = np.where(centre > FINE_NM, below, above)
    return np.asarray(height * np.exp(-0.5 * np.square((FINE_NM - centre) / width)))
