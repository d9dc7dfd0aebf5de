"""From uncertainty columns to a fit's covariance: which errors are shared by whom, and what that costs.

An error of size u that n samples share does not average out over them. Each column therefore knows its group:
noise and binning belong to one sample and channel; the white's noise to all samples that were divided by the
same white pixels; the lamp's drift between white and sample to all samples and channels of one pose; the
white's reflectance, the sensor's bent response, the stray light's rest and unseen drift to the whole session
and all channels; the white plate's unevenness and the lens to all samples of one place in the picture; a
joint's angle to all samples and channels of one pose, or of all poses that hold the joint at the same encoder
step. (GUM, JCGM 100:2008, section 5.2: correlated input quantities.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterable

    import xarray as xr

    from analysis.instrument import Seen
    from analysis.models.base import Model

Array = NDArray[np.float64]

INDEPENDENT = ("u_noise", "u_binning")
IN_F = (
    "u_noise",
    "u_binning",
    "u_white",
    "u_reference",
    "u_lamp",
    "u_linearity",
    "u_stray",
    "u_flat",
    "u_distortion",
    "u_drift",
)
"""Columns in 1/sr: the ones that u_f_r is the quadrature of."""

COMMON = ("reference", "linearity", "stray", "drift")
"""Shared errors that all samples have in common: they move a fit as a whole, and weigh no sample down."""

STEP_RAD = 1e-5
"""Step of the central difference along a joint: its error is far below the uncertainty of an uncertainty."""


@dataclass(frozen=True)
class SharedError:
    """An error that is fully correlated within groups of samples.

    Attributes
    ----------
    name : str
        What it is.
    column : ndarray, shape (N, C)
        Change of f_r for one standard uncertainty, with its sign, in 1/sr.
    group : ndarray of int, shape (N,)
        Samples with the same number share the error.
    across_channels : bool
        Whether the channels of a group share it too.
    """

    name: str
    column: Array
    group: NDArray[np.intp]
    across_channels: bool


def quadrature(*columns: Array) -> Array:
    """Root of the sum of squares of standard uncertainties; they broadcast."""
    total = np.zeros(())
    for column in columns:
        total = total + np.square(column)
    return np.sqrt(total)


def has_uncertainty(samples: xr.Dataset) -> bool:
    """Whether the samples say how uncertain they are."""
    return any(name in samples for name in ("u_f_r", *INDEPENDENT))


def independent(samples: xr.Dataset) -> Array:
    """Uncertainty that each sample has for itself, shape (N, C) in 1/sr.

    The columns `u_noise` and `u_binning` where they exist, else the whole `u_f_r`.
    """
    columns = [samples[name].to_numpy() for name in INDEPENDENT if name in samples]
    return quadrature(*columns) if columns else np.asarray(samples["u_f_r"].to_numpy(), dtype=np.float64)


def shared_in_f(samples: xr.Dataset) -> list[SharedError]:
    """Shared errors in 1/sr: the white's noise and reflectance, and what corrections leave."""
    errors = []
    count = samples.sizes["sample"]
    everyone = np.zeros(count, dtype=np.intp)
    if not any(name in samples for name in INDEPENDENT):
        # u_f_r stands for everything then, and has been counted.
        return []
    if "u_white" in samples:
        group = samples["white_group"].to_numpy() if "white_group" in samples else np.zeros(count)
        errors.append(
            SharedError("white", samples["u_white"].to_numpy(), _dense(group), across_channels=False)
        )
    for name, by in (
        *((name, None) for name in COMMON),
        ("lamp", "pose"),
        ("flat", "flat_group"),
        ("distortion", "flat_group"),
    ):
        column = f"u_{name}"
        if column in samples and (by is None or by in samples):
            group = everyone if by is None else _dense(samples[by].to_numpy())
            errors.append(SharedError(name, samples[column].to_numpy(), group, across_channels=True))
    return errors


def shared_by_pose(samples: xr.Dataset, model: Model | Seen) -> list[SharedError]:
    """Errors of the joints' angles, turned into errors of f_r with a model's gradient.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples; without `d_wi`, `d_wo`, `pose` and `u_joint_rad` the result is empty.
    model : Model
        The model whose gradient along the directions is taken.

    Returns
    -------
    list of SharedError
        One per joint.
    """
    if not all(name in samples for name in ("pose", "d_wi", "d_wo", "u_joint_rad")):
        return []
    wi, wo = samples["wi"].to_numpy(), samples["wo"].to_numpy()
    d_wi, d_wo = samples["d_wi"].to_numpy(), samples["d_wo"].to_numpy()
    errors = []
    for joint, u_rad in enumerate(samples["u_joint_rad"].to_numpy()):
        # Poses that hold a joint at the same encoder step share that step's error.
        shared_by = samples["joint_group"][:, joint] if "joint_group" in samples else samples["pose"]
        group = _dense(shared_by.to_numpy())
        slope = directional_slope(model, wi, wo, d_wi[:, joint], d_wo[:, joint])
        errors.append(SharedError(f"joint {joint}", u_rad * slope, group, across_channels=True))
    return errors


def directional_slope(model: Model | Seen, wi: Array, wo: Array, d_wi: Array, d_wo: Array) -> Array:
    """Differentiate a model's f_r along a joint movement of both directions.

    Parameters
    ----------
    model : Model
        The model.
    wi, wo : ndarray, shape (N, 3)
        Unit directions.
    d_wi, d_wo : ndarray, shape (N, 3)
        Their change per radian.

    Returns
    -------
    ndarray, shape (N, C)
        In 1/sr per radian.
    """
    sides = [
        model.evaluate(_moved(wi, step * d_wi), _moved(wo, step * d_wo)) for step in (STEP_RAD, -STEP_RAD)
    ]
    return (sides[0] - sides[1]) / (2.0 * STEP_RAD)


def _moved(direction: Array, change: Array) -> Array:
    moved = direction + change
    return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))


def _dense(group: NDArray[np.generic]) -> NDArray[np.intp]:
    """Group numbers without gaps."""
    return np.asarray(np.unique(group, return_inverse=True)[1].reshape(-1), dtype=np.intp)


def meat(scores: Array, own: Array, shared: Iterable[SharedError]) -> Array:
    """Covariance of the gradient of a weighted sum of squares: the filling of the sandwich.

    Parameters
    ----------
    scores : ndarray, shape (N, C, P)
        Derivative of the gradient by each datum: weight times derivative of the model, 0 for unused data.
    own : ndarray, shape (N, C)
        Independent standard uncertainty of each datum.
    shared : iterable of SharedError
        The correlated ones.

    Returns
    -------
    ndarray, shape (P, P)
        Sum over independent data and over groups of outer products.
    """
    count, channels, parameters = scores.shape
    flat = _scaled(scores, own).reshape(-1, parameters)
    total = flat.T @ flat
    for error in shared:
        weighted = _scaled(scores, np.broadcast_to(error.column, (count, channels)))
        parts = [weighted.sum(axis=1)] if error.across_channels else [weighted[:, c] for c in range(channels)]
        for part in parts:
            sums = np.zeros((int(error.group.max()) + 1, parameters))
            np.add.at(sums, error.group, part)
            total += sums.T @ sums
    return total


def _scaled(scores: Array, column: Array) -> Array:
    """Scores (N, C, P) times a column (N, C); unused data have score 0 and may state no uncertainty."""
    return np.asarray(scores * np.where(np.isfinite(column), column, 0.0)[..., None])
