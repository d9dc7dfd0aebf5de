"""From a camera's channels to CIE XYZ, fitted on a chart whose reflectances are known.

Only corrections that do not depend on the exposure are fitted: a matrix, and root polynomials (Finlayson,
Mackiewicz & Hurlbert 2015), whose terms all have the degree one. How well a correction does is told by the
patches that were left out of its fit, one at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.appearance import ciede2000
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

DEGREES = (1, 2, 3, 4)
"""Of root polynomials; 1 is the matrix."""
_PATCHES_PER_TERM = 1.5
"""With fewer, left-out patches are far from what the others say."""
_MARGIN = 0.05
"""A higher degree must lower the colour difference of left-out patches by this share."""


@dataclass(frozen=True, eq=False)
class ColourFit:
    """A correction of colour.

    Attributes
    ----------
    matrix : ndarray, shape (3, T)
        From the terms of `expanded` to XYZ.
    degree : int
        Of the root polynomial; 1 is a matrix, and the only one that a sum of lights passes through unchanged.
    white_xyz : ndarray, shape (3,)
        What a perfect white has.
    delta_e, left_out : ndarray, shape (N,)
        CIEDE2000 of each patch, with all patches fitted and with itself left out.
    """

    matrix: Array
    degree: int
    white_xyz: Array
    delta_e: Array
    left_out: Array

    def xyz(self, values: Array) -> Array:
        """XYZ (..., 3) of channels (..., 3), 1 for a perfect white; the white's Y is 1."""
        return np.asarray(expanded(values, self.degree) @ self.matrix.T)


def expanded(values: Array, degree: int) -> Array:
    """Return the terms of a root polynomial, (..., T) of (..., 3); all scale with the exposure.

    Finlayson, Mackiewicz & Hurlbert 2015, eqs. 11 to 13. Roots of negative products are those of their
    absolute value, with the sign.
    """
    from colour.characterisation import polynomial_expansion_Finlayson2015

    return np.asarray(polynomial_expansion_Finlayson2015(values, degree, True), dtype=np.float64)


def xyz_of_spectra(nm: Array, reflectance: Array, lamp: Array) -> Array:
    """XYZ of reflectances under a lamp, CIE 1931; a perfect white has Y = 1.

    Parameters
    ----------
    nm : ndarray, shape (K,)
        Evenly spaced wavelengths.
    reflectance : ndarray, shape (N, K)
    lamp : ndarray, shape (K,)
        Its spectrum, any unit.

    Returns
    -------
    ndarray, shape (N, 3)
    """
    from colour import MSDS_CMFS

    matching = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    observer = np.stack(
        [np.interp(nm, matching.wavelengths, column) for column in np.asarray(matching.values).T], axis=1
    )
    weights = observer * lamp[:, None]
    return np.asarray(reflectance @ weights / weights[:, 1].sum())


def lab(xyz: Array, white_xyz: Array) -> Array:
    """CIE Lab (N, 3) of XYZ (N, 3) beside a white; CIE 15:2004."""
    ratio = xyz / white_xyz
    limit = 6.0 / 29.0
    f = np.where(ratio > limit**3, np.cbrt(ratio), ratio / (3.0 * limit**2) + 4.0 / 29.0)
    return np.stack(
        [116.0 * f[:, 1] - 16.0, 500.0 * (f[:, 0] - f[:, 1]), 200.0 * (f[:, 1] - f[:, 2])], axis=1
    )


def fit_colour(
    values: Array, xyz: Array, white_xyz: Array, degree: int, *, keep_white: bool = True
) -> ColourFit:
    """Fit a correction of one degree.

    Parameters
    ----------
    values : ndarray, shape (N, 3)
        Channels, 1 for a perfect white.
    xyz : ndarray, shape (N, 3)
        What they should become.
    white_xyz : ndarray, shape (3,)
        That of a perfect white.
    degree : int
        One of `DEGREES`.
    keep_white : bool
        A perfect white becomes `white_xyz` exactly (Finlayson & Drew 1997).

    Returns
    -------
    ColourFit

    Raises
    ------
    BadInput
        Values that are not finite, or too few of them for the degree.
    """
    terms = expanded(values, degree)
    if not (np.isfinite(terms).all() and np.isfinite(xyz).all()):
        raise BadInput("patches without a value", where="the chart", todo="see which are clipped")
    if len(terms) <= terms.shape[1]:
        what = f"{len(terms)} patches for {terms.shape[1]} terms"
        raise BadInput(what, where=f"degree {degree}", todo="ask for a lower degree")
    white_terms = expanded(np.ones((1, 3)), degree)[0] if keep_white else None
    matrix = _solved(terms, xyz, white_xyz, white_terms)
    truth = lab(xyz, white_xyz)
    left_out = np.empty(len(terms))
    for number in range(len(terms)):
        rest = np.arange(len(terms)) != number
        other = _solved(terms[rest], xyz[rest], white_xyz, white_terms)
        found = lab(terms[number : number + 1] @ other.T, white_xyz)
        left_out[number] = ciede2000(found, truth[number : number + 1])[0]
    delta_e = ciede2000(lab(terms @ matrix.T, white_xyz), truth)
    return ColourFit(matrix, degree, white_xyz, delta_e, left_out)


def choose_colour(
    values: Array, xyz: Array, white_xyz: Array, degrees: Sequence[int] = DEGREES, *, keep_white: bool = True
) -> list[ColourFit]:
    """Fit every degree; the first is to be used: the lowest that left-out patches do not speak against.

    Parameters, Raises
        As `fit_colour`; degrees with too many terms for the patches are passed over.
    """
    fits = [
        fit_colour(values, xyz, white_xyz, degree, keep_white=keep_white)
        for degree in degrees
        if len(values) >= _PATCHES_PER_TERM * expanded(np.ones((1, 3)), degree).shape[1]
    ]
    if not fits:
        raise BadInput(f"{len(values)} patches are too few", where="the chart", todo="use all of its patches")
    best = fits[0]
    for fit in fits[1:]:
        if fit.left_out.mean() < (1.0 - _MARGIN) * best.left_out.mean():
            best = fit
    return [best, *(fit for fit in fits if fit is not best)]


def _solved(terms: Array, xyz: Array, white_xyz: Array, white_terms: Array | None) -> Array:
    """Matrix (3, T) of least squares in Lab, started relative to Y; the white kept if asked."""
    from scipy.linalg import null_space
    from scipy.optimize import least_squares

    if white_terms is None:
        particular, free = np.zeros((3, terms.shape[1])), np.eye(terms.shape[1])
    else:
        particular = np.outer(white_xyz, white_terms) / (white_terms @ white_terms)
        free = null_space(white_terms[None, :])
    weight = 1.0 / np.maximum(xyz[:, 1:2], 1e-3)
    start = np.linalg.lstsq(weight * (terms @ free), weight * (xyz - terms @ particular.T), rcond=None)[0]
    truth = lab(xyz, white_xyz)

    def matrix(x: Array) -> Array:
        return np.asarray(particular + x.reshape(free.shape[1], 3).T @ free.T)

    def apart(x: Array) -> Array:
        return np.asarray((lab(terms @ matrix(x).T, white_xyz) - truth).ravel())

    return matrix(least_squares(apart, start.ravel(), method="lm", max_nfev=2000).x)
