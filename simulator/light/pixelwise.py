"""Radiance at pixel centres from f_r alone: geometry in float64, no ray is traced.

With one flat sample, a lamp small enough to be a point and black surroundings the light paths are LDE, and
the radiance of a pixel is f_r(wi, wo) E, with E = level (d/r)^2 cos theta_i at the point where the ray
through the pixel's centre meets the sample.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.pixels import irradiance, pixel_geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.description import Rig

Array = NDArray[np.float64]


class PixelwiseLight:
    """Light on one material, asked for its f_r at every pixel's centre.

    Parameters
    ----------
    rig : Rig
        The machine.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    """

    def __init__(self, rig: Rig, reflectance: Callable[[Array, Array], Array]) -> None:
        self._rig = rig
        self._reflectance = reflectance

    def radiance(self, angles_rad: Sequence[float]) -> Array:
        """Radiance at level 1.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.

        Returns
        -------
        ndarray, shape (height, width, 3)
            Zero beside the sample.
        """
        pixels = pixel_geometry(self._rig, np.asarray(angles_rad))
        seen = pixels.on_sample & (pixels.wi[..., 2] > 0.0)
        radiance = np.zeros((*seen.shape, 3))
        f_r = self._reflectance(pixels.wi[seen], pixels.wo[seen])
        radiance[seen] = f_r * irradiance(self._rig, pixels)[seen, None]
        return radiance
