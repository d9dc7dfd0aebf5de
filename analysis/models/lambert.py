"""The ideal diffuser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from analysis.models.base import KD, Geometry, Lobe, Model, Parameter

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class Lambert(Model):
    """f_r = kd/pi (Lambert 1760): the same radiance in every direction.

    Parameters
    ----------
    kd : float or array_like, shape (channels,)
        Diffuse albedo.
    """

    kd: ArrayLike = KD.default

    NAME: ClassVar[str] = "lambert"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD,)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe | None:  # noqa: ARG002 - the interface of all models
        """Return None: there is no lobe."""
        return None
