"""The white reference: its reflectance relative to a perfect diffuser, as a function of both directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rig.description import Rig

    Float = NDArray[np.float64]


class WhiteReference(Protocol):
    """What a reduction asks of a white: its f_r is `rho(wi, wo) / pi`."""

    @property
    def u_rho(self) -> float:
        """Standard uncertainty of rho, common to all directions and channels."""
        ...

    def rho(self, wi: Float, wo: Float) -> Float:
        """Reflectance factor for unit directions wi, wo (..., 3); shape (...)."""
        ...


@dataclass(frozen=True)
class LambertianWhite:
    """A white that looks the same from everywhere.

    Real pressed PTFE departs from this by percents beyond 60 degrees.

    Attributes
    ----------
    value : float
        Reflectance factor, 0 to 1.
    u_rho : float
        Its standard uncertainty (k = 1), from the certificate.
    """

    value: float
    u_rho: float

    def rho(self, wi: Float, wo: Float) -> Float:
        """Reflectance factor for unit directions wi, wo (..., 3); shape (...)."""
        return np.full(np.broadcast_shapes(wi.shape, wo.shape)[:-1], self.value)


def white_of(rig: Rig) -> WhiteReference:
    """Build the white reference that a rig's description names.

    Raises
    ------
    BadInput
        For a reflectance that is not a positive number.
    """
    rho = rig.white.rho
    if not isinstance(rho, float | int) or not rho > 0:
        raise BadInput(
            f"the white's reflectance {rho!r} is not a positive number",
            where="rig.toml [white] rho",
            todo="give the certified hemispherical value, for example 0.99",
        )
    return LambertianWhite(float(rho), float(rig.white.u_rho))
