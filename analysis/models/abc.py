"""The ABC model of Löw and others, for glossy surfaces with a sharp peak and a long tail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter, product
from analysis.models.cook_torrance import IOR
from analysis.models.microfacet import facets_dielectric, v_groove_visibility

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

B = Parameter(
    "b",
    Kind.SHAPE,
    bounds=(1.0, 1e7),
    minimum=0.0,
    default=500.0,
    coordinate=Coordinate.LOG,
    scan=(5.0, 30.0, 200.0, 2e3, 3e4, 1e6),
    of_slope=lambda slope: 2.0 / slope**2,
)
C = Parameter(
    "c",
    Kind.SHAPE,
    bounds=(0.02, 5.0),
    minimum=0.0,
    default=1.3,
    coordinate=Coordinate.LOG,
    scan=(0.1, 0.4, 1.0, 1.8, 3.0),
)


@dataclass(frozen=True, eq=False)
class ABC(Model):
    """f_r = kd/pi + ks F G D / (pi (N.L)(N.E)), D = 1 / (1 + b (1 - N.H))^c.

    The microfacet form of Löw, Kronander, Ynnerman & Unger 2012 (their A is ks; K-correlation's A, B, C of
    optical scatter), with V-groove G and the exact dielectric F, as the parameters published for the MERL
    materials are to be read. D is 1 at its peak and not normalised: ks is no albedo.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale (A).
    b : float or array_like, shape (channels,)
        Inverse of the peak's width, in units of 1 - cos.
    c : float or array_like, shape (channels,)
        Power by which the tail falls.
    ior : float or array_like, shape (channels,)
        Index of refraction of the facets, >= 1.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    b: ArrayLike = B.default
    c: ArrayLike = C.default
    ior: ArrayLike = IOR.default

    NAME: ClassVar[str] = "abc"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, B, C, IOR)

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F G D / (pi (N.L)(N.E)) and its derivatives by b, c and ior."""
        b, c = np.asarray(self.b), np.asarray(self.c)
        secant = np.sqrt(1.0 + geometry.tan2_h)
        # 1 - cos = tan^2 / (sec (sec + 1)), which keeps its digits near the normal.
        drop = geometry.tan2_h / secant / (secant + 1.0)
        logarithm = np.log1p(b * drop)
        density = np.exp(-c * logarithm)
        slopes = {"b": -density * c * drop / (1.0 + b * drop), "c": -density * logarithm}
        grooves = Lobe(v_groove_visibility(geometry) / np.pi, {})
        return product(Lobe(density, slopes), grooves, facets_dielectric(geometry, self.ior))
