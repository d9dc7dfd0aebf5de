"""A fit against its samples: residuals, pulls, and the angles by which people look at them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.uncertainty import COMMON, IN_F, quadrature, shared_by_pose
from rig.angles import half_difference

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model

    Float = NDArray[np.float64]

INDEPENDENT = ("u_noise", "u_white", "u_binning")
"""Columns that scatter from sample to sample; `u_reference` moves all samples together and shows in no
residual."""


@dataclass(frozen=True)
class View:
    """The angles of samples, radians, each (N,).

    Attributes
    ----------
    theta_i, theta_o, theta_h : (N,) float
        From the normal to light, camera and half vector.
    off_plane : (N,) float
        How far the camera lies off the plane of incidence: 0 in plane.
    signed_theta_o : (N,) float
        theta_o, positive on the mirror's side of the normal, negative on the light's.
    """

    theta_i: Float
    theta_o: Float
    theta_h: Float
    off_plane: Float
    signed_theta_o: Float


def view_angles(wi: Float, wo: Float) -> View:
    """Compute the angles of direction pairs wi, wo (N, 3)."""
    theta_h, _, _, _ = half_difference(wi, wo)
    sideways = np.hypot(wi[:, 0], wi[:, 1])
    toward = np.where(sideways[:, None] > 1e-9, wi[:, :2] / np.maximum(sideways, 1e-300)[:, None], [1.0, 0.0])
    along = -np.einsum("ij,ij->i", toward, wo[:, :2])
    across = toward[:, 0] * wo[:, 1] - toward[:, 1] * wo[:, 0]
    return View(
        theta_i=np.arctan2(sideways, wi[:, 2]),
        theta_o=np.arctan2(np.hypot(wo[:, 0], wo[:, 1]), wo[:, 2]),
        theta_h=theta_h,
        off_plane=np.arcsin(np.clip(across, -1.0, 1.0)),
        signed_theta_o=np.arctan2(along, wo[:, 2]),
    )


@dataclass(frozen=True)
class Evaluation:
    """A model beside the samples it was fitted to; N samples, C channels.

    Attributes
    ----------
    fitted, residual : (N, C) float
        The model's f_r and samples minus model, 1/sr.
    columns : dict of str to (N, C) float
        Standard uncertainty by source, 1/sr: noise, white, reference, binning, pose; those that the samples
        have.
    pull : (N, C) float
        Residual over what should scatter it; NaN without stated uncertainties.
    """

    fitted: Float
    residual: Float
    columns: dict[str, Float]
    pull: Float


def evaluate_fit(samples: xr.Dataset, model: Model) -> Evaluation:
    """Set a fitted model beside samples with whatever uncertainty columns they carry."""
    wi, wo = samples["wi"].to_numpy(), samples["wo"].to_numpy()
    measured = samples["f_r"].to_numpy()
    fitted = np.broadcast_to(model.evaluate(wi, wo), measured.shape)
    columns = {
        name.removeprefix("u_"): samples[name].to_numpy()
        for name in (*INDEPENDENT, "u_reference")
        if name in samples
    }
    poses = shared_by_pose(samples, model)
    if poses:
        columns["pose"] = quadrature(*(error.column for error in poses))
    # What all samples have in common moves the fit as a whole and scatters nothing.
    own = [name for name in IN_F if name in samples and name.removeprefix("u_") not in COMMON]
    scatter = [samples[name].to_numpy() for name in own]
    scatter += [columns["pose"]] if poses else []
    if not scatter and "u_f_r" in samples:
        scatter = [samples["u_f_r"].to_numpy()]
    total = quadrature(np.zeros(measured.shape), *scatter)
    residual = measured - fitted
    with np.errstate(invalid="ignore", divide="ignore"):
        pull = np.where(total > 0, residual / total, np.nan)
    return Evaluation(fitted, residual, columns, pull)
