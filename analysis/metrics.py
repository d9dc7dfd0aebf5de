"""How well a model meets samples, in the numbers that the field compares; never one number alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.losses import log_one_plus

Array = NDArray[np.float64]


def goodness(
    fitted: Array,
    data: Array,
    used: NDArray[np.bool_],
    *,
    wi: Array,
    wo: Array,
    uncertainty: Array | None = None,
    parameters: int = 0,
) -> dict[str, float]:
    """Compare a model with samples.

    With f the model, d the datum, x = cos(theta_i), and sums over all data used, all channels alike:

    - `rms_log`: sqrt(mean (ln(1 + f x) - ln(1 + d x))^2);
    - `l2_cos`: sqrt(sum w ((f - d) x)^2 / sum w), w = sin(theta_i) sin(theta_o), the solid angles
      of a grid even in angle (Ngan, Durand & Matusik 2005), in 1/sr;
    - `rms_cbrt`: sqrt(mean ((f x)^(1/3) - (d x)^(1/3))^2) (Fores, Ferwerda & Gu 2012);
    - `median_relative`: median |f - d| / d, over d > 0;
    - `chi2_dof`: sum ((f - d)/u)^2 / (data - parameters), where u is known.

    Parameters
    ----------
    fitted, data : ndarray, shape (N, C)
        The model's and the measured f_r in 1/sr.
    used : ndarray of bool, shape (N, C)
        Which data count.
    wi, wo : ndarray, shape (N, 3)
        Unit directions.
    uncertainty : ndarray, shape (N, C), optional
        Standard uncertainty of the data in 1/sr.
    parameters : int
        Number of parameters that were fitted.

    Returns
    -------
    dict of str to float
        The metrics; one that has no data to stand on is NaN.
    """
    solid = np.hypot(wi[:, 0], wi[:, 1]) * np.hypot(wo[:, 0], wo[:, 1])
    if used.all():
        rows, (f, d) = np.repeat(np.arange(len(wi)), data.shape[1]), (fitted.ravel(), data.ravel())
    else:
        rows, f, d = np.nonzero(used)[0], fitted[used], data[used]
    x, weight = wi[rows, 2], solid[rows]
    positive = d > 0.0
    metrics = {
        "rms_log": _rms(log_one_plus(f * x) - log_one_plus(d * x)),
        "l2_cos": float(np.sqrt(weight @ np.square((f - d) * x) / weight.sum())) if weight.any() else np.nan,
        "rms_cbrt": _rms(np.cbrt(f * x) - np.cbrt(d * x)),
        "median_relative": float(np.median(np.abs(f - d)[positive] / d[positive]))
        if positive.any()
        else np.nan,
    }
    if uncertainty is not None:
        free = f.size - parameters
        chi2 = float(np.sum(np.square((f - d) / uncertainty[used])))
        metrics["chi2_dof"] = chi2 / free if free > 0 else np.nan
    return metrics


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(np.square(difference))))
