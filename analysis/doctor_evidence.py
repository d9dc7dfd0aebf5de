"""How well a reading agrees with what surfaces do: one number, comparable between readings of one file.

A surface's BRDF is reciprocal, mostly the same on both sides of the plane of incidence, smooth, and has its
peak, where it has one, at the mirror direction. So ln f is taken as

    ln f = ln(kd / pi + ks G) + s(theta_h, theta_d, cos 2 phi_d) + noise,

with G a lobe of facets, chosen from a list, and s a Gaussian process of angles that do not change when light
and view are exchanged or mirrored (Rusinkiewicz 1998). What is not reciprocal, symmetric or smooth goes into
the noise; a lobe in the wrong place has to be made up for by s. In place of both terms there may be a rough
diffuser, which sends light back (Oren & Nayar 1994). The evidence is the process's marginal likelihood
(Rasmussen & Williams 2006, equation 2.30) with the noise's size profiled and few centres in place of all
samples (their section 8.3.2). A factor on the values is a shift of ln f, so that readings with and without a
cosine compare.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.models import MODELS
from analysis.models.base import Geometry
from rig.angles import half_difference

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.angle_table import AngleTable

Array = NDArray[np.float64]

LOBES_OF = (("ggx", "alpha"), ("cook-torrance-schlick", "m"))
"""Families of lobes: long tails and short ones, each with the name of its width."""
ALPHAS = (0.008, 0.02, 0.05, 0.1, 0.2, 0.35, 0.6)
FRESNEL = (0.04, 0.5)
ROUGHNESS = (0.2, 0.4, 0.7)
"""Slopes of the facets of rough diffusers, radians."""
RATIOS = tuple(10.0 ** np.arange(-2.0, 3.1, 0.5))
"""ks over kd of the lobes that are tried."""
LENGTHS = (0.5, 1.0, 2.0)
SIGNALS = (0.0, 0.1, 1.0, 10.0, 100.0, 1000.0)
"""Variance of the process over that of the noise."""
CENTRES = 80
LOBES = 3
"""Lobes, best first, with which the process is tried."""
NARROWEST = np.radians(5.0)
"""Angle between half vector and normal below which lengths shrink with the angle no further."""


@dataclass(frozen=True)
class Evidence:
    """What speaks for a reading, per sample, in natural logarithms.

    Attributes
    ----------
    total : float
        Logarithm of the marginal likelihood over the number of samples.
    lobe_rms : float
        RMS of ln f about the best lobe alone.
    noise_rms : float
        RMS of what is neither lobe nor smooth, reciprocal and symmetric.
    """

    total: float
    lobe_rms: float
    noise_rms: float


def evidence(table: AngleTable, weights: Array, lengths: Sequence[float] = LENGTHS) -> Evidence:
    """Weigh a reading.

    Parameters
    ----------
    table : AngleTable
        Samples above the horizon, one channel, all values positive.
    weights : ndarray, shape (N,)
        Inverse relative variance of each value's logarithm, up to a factor.
    lengths : sequence of float
        Lengths of the process's covariance that are tried.

    Returns
    -------
    Evidence
    """
    wi, wo = table.wi, table.wo
    target = np.log(table.f_r[:, 0])
    root = np.sqrt(weights)
    lobes = _lobes(wi, wo)
    residual = target[:, None] - lobes
    residual -= weights @ residual / weights.sum()
    spread = weights @ np.square(residual)
    best = np.argsort(spread)[:LOBES]
    features = _features(wi, wo)
    centres = features[_spread_out(features)]
    found = max(
        (_marginal(features / length, centres / length, residual[:, best], root) for length in lengths),
        key=lambda pair: pair[0],
    )
    scale = weights.sum()
    return Evidence(found[0], float(np.sqrt(spread[best[0]] / scale)), float(np.sqrt(found[1] / scale)))


def _lobes(wi: Array, wo: Array) -> Array:
    """Logarithms of Lambert and lobes (N, M) over the list of widths, reflectances and strengths."""
    geometry = Geometry(wi, wo)
    columns = [np.zeros(len(wi))]
    for model, width in LOBES_OF:
        for alpha in ALPHAS:
            for f0 in FRESNEL:
                lobe = MODELS[model](**{width: alpha, "f0": f0}).basis_at(geometry)["ks"][:, 0]
                columns += [np.log(1.0 / np.pi + ratio * lobe) for ratio in RATIOS]
    for slope in ROUGHNESS:
        diffuser = {"kd": 1.0, "sigma_rad": slope}
        columns.append(np.log(MODELS["oren-nayar"](**diffuser).evaluate(wi, wo)[:, 0]))
    return np.stack(columns, axis=1)


def _features(wi: Array, wo: Array) -> Array:
    """Angles (N, 3) that are the same for light and view exchanged and for both sides of the plane."""
    theta_h, _, theta_d, phi_d = half_difference(wi, wo)
    out_of_plane = np.sin(theta_h) * np.sin(theta_d) * np.cos(2.0 * phi_d)
    return np.stack([np.arcsinh(theta_h / NARROWEST), 2.0 * theta_d, 2.0 * out_of_plane], axis=1)


def _marginal(features: Array, centres: Array, residual: Array, root: Array) -> tuple[float, float]:
    """Return the best marginal likelihood over signals and lobes, and the noise's weighted square sum."""
    count = len(features)
    basis = _kernel(features, centres) * root[:, None]
    # Whitened by the centres' own covariance, basis @ basis.T is the process's (Nystrom 1930).
    factor = np.linalg.cholesky(_kernel(centres, centres) + 1e-6 * np.eye(len(centres)))
    basis = np.linalg.solve(factor, basis.T)
    values, vectors = np.linalg.eigh(basis @ basis.T)
    values = np.maximum(values, 0.0)
    projected = np.square(vectors.T @ (basis @ (root[:, None] * residual)))
    squares = np.square(root[:, None] * residual).sum(axis=0)
    best = (-np.inf, 0.0)
    for signal in SIGNALS:
        shrink = signal / (1.0 + signal * values)
        left = np.maximum(squares - shrink @ projected, 1e-12 * count)
        likelihood = -0.5 * np.log(left / count) - 0.5 * np.log1p(signal * values).sum() / count
        lobe = int(np.argmax(likelihood))
        if likelihood[lobe] > best[0]:
            best = (float(likelihood[lobe]), float(left[lobe]))
    return best


def _kernel(a: Array, b: Array) -> Array:
    """Squared-exponential covariance (Rasmussen & Williams 2006, equation 4.9)."""
    square = np.square(a).sum(1)[:, None] + np.square(b).sum(1) - 2.0 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0.0)))


def _spread_out(features: Array) -> NDArray[np.intp]:
    """Choose centres: each the point farthest from those chosen before (Gonzalez 1985)."""
    chosen = [0]
    distance = np.square(features - features[0]).sum(1)
    while len(chosen) < min(CENTRES, len(features)):
        farthest = int(np.argmax(distance))
        if distance[farthest] < 1e-8:
            break
        chosen.append(farthest)
        distance = np.minimum(distance, np.square(features - features[farthest]).sum(1))
    return np.array(chosen, dtype=np.intp)
