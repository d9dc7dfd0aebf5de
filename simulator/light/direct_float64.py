"""Nodes of the direct light evaluated in float64, with any f_r that can be asked for pairs of directions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.light.direct_view import meet, sample_share

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.direct_view import Extents, Lens, View
    from simulator.light.sparse_rules import Rule

Array = NDArray[np.float64]

ROUNDING = 1e-13
"""Relative error of one radiance."""


class Float64Nodes:
    """Direct light on a flat sample, node by node.

    Parameters
    ----------
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    extents : Extents
        Of lamp, pixel and pupil.
    sample_radius_mm : float
        Of the disc that is lit.
    """

    rounding = ROUNDING
    step_rad = 0.0

    def __init__(
        self, reflectance: Callable[[Array, Array], Array], extents: Extents, sample_radius_mm: float
    ) -> None:
        self._reflectance = reflectance
        self._extents = extents
        self._radius_mm = sample_radius_mm

    def radiance(self, views: Sequence[View], lens: Lens, rule: Rule) -> Array:
        """Mean radiance of pixels over a rule's nodes.

        Parameters
        ----------
        views : sequence of View
            P poses.
        lens : Lens
            N pixels.
        rule : Rule
            Nodes of lamp, pixel and pupil.

        Returns
        -------
        ndarray, shape (P, N, 3)
            Times the share of the pixel that the sample fills.
        """
        return np.stack([self._pose(view, lens, rule) for view in views])

    def _pose(self, view: View, lens: Lens, rule: Rule) -> Array:
        radiance = np.zeros((len(lens), 3))
        share = sample_share(view, lens, self._extents.pixel, self._radius_mm)
        seen = np.flatnonzero(share > 0.0)
        lens = lens[seen]
        total = np.zeros((len(seen), 3))
        for node, weight in zip(rule.nodes, rule.weights, strict=True):
            points, _ = meet(view, lens, self._extents.pixel * node[2:4], node[4:])
            to_light = view.light_mm + node[:2] @ view.light_disc_mm - points
            to_camera = view.camera_mm + node[4:] @ view.pupil_disc_mm - points
            light_mm = np.linalg.norm(to_light, axis=-1, keepdims=True)
            wi = to_light / light_mm
            strength = weight * view.strength / light_mm**2 * np.maximum(wi[:, 2:], 0.0)
            if self._extents.lamp_radius_mm > 0.0:
                strength *= -(wi @ view.facing)[:, None]
            wo = to_camera / np.linalg.norm(to_camera, axis=-1, keepdims=True)
            lit = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
            total[lit] += strength[lit] * self._reflectance(wi[lit], wo[lit])
        radiance[seen] = share[seen, None] * total
        return radiance
