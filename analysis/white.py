"""The white reference: its reflectance relative to a perfect diffuser, for both directions and each channel.

rho(wi, wo, channel) is the certificate's 8 deg/hemispherical reflectance at the channel's wavelength, times a
shape (`analysis.white_shape`). Both come from `calibration/white.toml`; without that file the rig file's
reflectance stands for the certificate and the generic shape, with its large uncertainty, for the plate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from analysis.white_shape import PtfeShape
from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.white_calibration import WhiteCalibration
    from rig.description import Rig

    Float = NDArray[np.float64]


class WhiteReference(Protocol):
    """What a reduction asks of a white: its f_r is `rho(wi, wo, channel) / pi`."""

    @property
    def name(self) -> str:
        """What it is, in words."""
        ...

    def rho(self, wi: Float, wo: Float, channel: Any = 0) -> Float:
        """Reflectance factor for unit directions wi, wo (..., 3) and channel indices (...); shape (...)."""
        ...

    def u_rho(self, wi: Float, wo: Float, channel: Any = 0) -> Float:
        """Its standard uncertainty: one error for all directions and channels, as large as this in each."""
        ...


@dataclass(frozen=True)
class LambertianWhite:
    """A white that looks the same from everywhere: the twin's.

    Real pressed PTFE departs from this by percents beyond 60 degrees.

    Attributes
    ----------
    value : float
        Reflectance factor, 0 to 1.
    u_value : float
        Its standard uncertainty (k = 1), from the certificate.
    """

    value: float
    u_value: float

    @classmethod
    def of(cls, rig: Rig) -> LambertianWhite:
        """Lambertian white of the reflectance that a rig file states."""
        return cls(*certified(rig))

    @property
    def name(self) -> str:
        """What it is, in words."""
        return f"Lambertian, {self.value:g}"

    def rho(self, wi: Float, wo: Float, channel: Any = 0) -> Float:
        """Reflectance factor for unit directions wi, wo (..., 3) and channel indices (...); shape (...)."""
        shape = np.broadcast_shapes(wi.shape[:-1], wo.shape[:-1], np.shape(channel))
        return np.full(shape, self.value)

    def u_rho(self, wi: Float, wo: Float, channel: Any = 0) -> Float:
        """Its standard uncertainty, the same everywhere."""
        return np.full(self.rho(wi, wo, channel).shape, self.u_value)


@dataclass(frozen=True, eq=False)
class PlateWhite:
    """A white plate with a certificate and a shape.

    Attributes
    ----------
    values, u_values : ndarray, shape (C,) or (1,)
        8 deg/hemispherical reflectance of each channel, or of all, and its standard uncertainty.
    shape : PtfeShape
    name : str
        What it is, in words.
    """

    values: Float
    u_values: Float
    shape: PtfeShape
    name: str

    def rho(self, wi: Float, wo: Float, channel: Any = 0) -> Float:
        """Reflectance factor for unit directions wi, wo (..., 3) and channel indices (...); shape (...)."""
        return np.asarray(self._of(self.values, channel) * self.shape.factor(wi, wo))

    def u_rho(self, wi: Float, wo: Float, channel: Any = 0) -> Float:
        """Its standard uncertainty, of certificate and shape."""
        relative = self._of(self.u_values, channel) / self._of(self.values, channel)
        return np.asarray(self.rho(wi, wo, channel) * np.hypot(relative, self.shape.u_relative(wi, wo)))

    @staticmethod
    def _of(values: Float, channel: Any) -> Float:
        return np.asarray(values[0] if len(values) == 1 else values[np.asarray(channel)])


def certified(rig: Rig) -> tuple[float, float]:
    """Reflectance and standard uncertainty that a rig file states of its white.

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
    return float(rho), float(rig.white.u_rho)


def white_of(rig: Rig, calibration: WhiteCalibration | None, channels: int) -> WhiteReference:
    """Build the white reference of a machine.

    Parameters
    ----------
    rig : Rig
        States the reflectance where the calibration has no certificate.
    calibration : WhiteCalibration or None
        `calibration/white.toml`; None where the machine has none.
    channels : int
        Of the camera.

    Returns
    -------
    WhiteReference

    Raises
    ------
    BadInput
        For a reflectance that is not a positive number, or wavelengths for another number of channels.
    """
    rho, u_rho = certified(rig)
    values, u_values = np.array([rho]), np.array([u_rho])
    if calibration is not None and calibration.certificate is not None:
        values, u_values = calibration.of_channels(channels)
    if calibration is not None and calibration.lambertian:
        return LambertianWhite(float(values.mean()), float(np.hypot(u_values.max(), np.ptp(values) / 2.0)))
    if calibration is None or calibration.points is None:
        return PlateWhite(values, u_values, PtfeShape.generic(), "generic PTFE, nothing of it measured")
    points = calibration.points
    shape = PtfeShape.fitted(points.wi, points.wo, points.factor, points.u_relative)
    return PlateWhite(values, u_values, shape, f"PTFE with {len(points.factor)} measured points")
