"""The white's calibration file `calibration/white.toml`.

A certificate is a table of wavelength, 8 deg/hemispherical reflectance and standard uncertainty. Points are
reflectance factors at pairs of directions; only their ratios count, for the certificate gives the scale.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.angles import spherical_to_direction
from rig.errors import BadInput
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Float = NDArray[np.float64]

FORMAT_VERSION = 1
WHITE_FILE = "white.toml"
VISIBLE_NM = (400.0, 700.0)
"""Over these the certificate is averaged for channels of unknown wavelength; its spread is uncertainty."""

U_CENTRE_NM = 10.0
"""Standard uncertainty of an effective wavelength: it moves with the lamp and the sample's colour."""

_LARGEST_FILE = 4_000_000
_LISTS = (
    "certificate_nm",
    "certificate_rho",
    "certificate_u",
    "channel_nm",
    "point_theta_i_deg",
    "point_phi_i_deg",
    "point_theta_o_deg",
    "point_phi_o_deg",
    "point_factor",
    "point_u_relative",
)
_TEXTS = ("shape", "name", "date", "note")
_SHAPES = ("ptfe", "lambertian")


@dataclass(frozen=True, eq=False)
class Certificate:
    """8 deg/hemispherical reflectance over wavelength.

    Attributes
    ----------
    nm, rho, u : ndarray, shape (N,)
        Ascending wavelength, reflectance, its standard uncertainty.
    """

    nm: Float
    rho: Float
    u: Float

    def at(self, nm: float) -> tuple[float, float]:
        """Reflectance and uncertainty at a wavelength.

        Raises
        ------
        BadInput
            The certificate does not reach it.
        """
        if not self.nm[0] <= nm <= self.nm[-1]:
            what = f"the certificate covers {self.nm[0]:g} to {self.nm[-1]:g} nm, not {nm:g} nm"
            raise BadInput(what, where="channel_nm", todo="give wavelengths within it")
        return float(np.interp(nm, self.nm, self.rho)), float(np.interp(nm, self.nm, self.u))

    def of_band(self, nm: float) -> tuple[float, float]:
        """Reflectance and uncertainty in a channel, whose effective wavelength is known to some nm itself.

        Raises
        ------
        BadInput
            The certificate does not reach it.
        """
        rho, u = self.at(nm)
        below, above = np.interp([nm - U_CENTRE_NM, nm + U_CENTRE_NM], self.nm, self.rho)
        return rho, math.hypot(u, 0.5 * float(above - below))

    def visible(self) -> tuple[float, float]:
        """Mean over the visible; its uncertainty holds the spread."""
        inside = (self.nm >= VISIBLE_NM[0]) & (self.nm <= VISIBLE_NM[1])
        chosen = inside if inside.any() else np.ones(len(self.nm), dtype=bool)
        spread = float(np.std(self.rho[chosen]))
        return float(np.mean(self.rho[chosen])), math.hypot(float(np.max(self.u[chosen])), spread)


@dataclass(frozen=True, eq=False)
class Points:
    """Measured reflectance factors of a white.

    Attributes
    ----------
    theta_i_deg, phi_i_deg, theta_o_deg, phi_o_deg : ndarray, shape (N,)
        Directions to light and camera.
    factor : ndarray, shape (N,)
    u_relative : ndarray, shape (N,), or None
        Relative standard uncertainties without that of the common scale, where they are known.
    """

    theta_i_deg: Float
    phi_i_deg: Float
    theta_o_deg: Float
    phi_o_deg: Float
    factor: Float
    u_relative: Float | None = None

    @property
    def wi(self) -> Float:
        """Unit directions to the light, shape (N, 3)."""
        return spherical_to_direction(np.deg2rad(self.theta_i_deg), np.deg2rad(self.phi_i_deg))

    @property
    def wo(self) -> Float:
        """Unit directions to the camera, shape (N, 3)."""
        return spherical_to_direction(np.deg2rad(self.theta_o_deg), np.deg2rad(self.phi_o_deg))


@dataclass(frozen=True, eq=False)
class WhiteCalibration:
    """All that is known of a white.

    Attributes
    ----------
    certificate : Certificate or None
        None: the rig file's reflectance stands for it.
    points : Points or None
    channel_nm : tuple of float
        Effective wavelength of each channel of the camera; empty where unknown.
    lambertian : bool
        Whether it is taken for a perfect diffuser's shape.
    name, date, note : str or None
    """

    certificate: Certificate | None = None
    points: Points | None = None
    channel_nm: tuple[float, ...] = ()
    lambertian: bool = False
    name: str | None = None
    date: str | None = None
    note: str | None = None

    def of_channels(self, channels: int) -> tuple[Float, Float]:
        """Certified reflectance of each channel and its standard uncertainty, shape (C,) or (1,).

        Raises
        ------
        BadInput
            There is no certificate, it does not reach a wavelength, or there are others than channels.
        """
        if self.certificate is None:
            raise BadInput("the white has no certificate", where=WHITE_FILE, todo="add one")
        if not self.channel_nm:
            rho, u = self.certificate.visible()
            return np.array([rho]), np.array([u])
        if len(self.channel_nm) != channels:
            what = f"{len(self.channel_nm)} wavelengths for {channels} channels"
            raise BadInput(what, where="channel_nm", todo="give one for each channel of the camera")
        pairs = [self.certificate.of_band(nm) for nm in self.channel_nm]
        return np.array([rho for rho, _ in pairs]), np.array([u for _, u in pairs])


def load_white(path: Path) -> WhiteCalibration:
    """Read a white's calibration file.

    Parameters
    ----------
    path : Path
        Usually `calibration/white.toml`.

    Raises
    ------
    BadInput
        It is missing, no TOML, or holds unknown or impossible values.
    """
    text = read_text(path, "give a white.toml")
    try:
        return _calibration(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"not TOML ({error})", where=str(path), todo="correct the file") from None
    except BadInput as error:
        where = f"{path} {error.where}" if error.where else str(path)
        raise BadInput(error.what, where=where, todo=error.todo) from None


def read_text(path: Path, todo: str) -> str:
    """Read a text file of another; bytes that are no UTF-8 become marks.

    Raises
    ------
    BadInput
        It is missing, too large or unreadable.
    """
    try:
        size = path.stat().st_size
        text = path.read_text(encoding="utf-8", errors="replace") if size <= _LARGEST_FILE else None
    except OSError as error:
        raise BadInput(f"cannot read: {error.strerror}", where=str(path), todo=todo) from None
    if text is None:
        raise BadInput(f"larger than {_LARGEST_FILE} bytes", where=str(path), todo=todo)
    return text


def _calibration(content: dict[str, Any]) -> WhiteCalibration:
    if content.pop("version", FORMAT_VERSION) != FORMAT_VERSION:
        raise BadInput("its version is not known", todo=f"this gonio reads version {FORMAT_VERSION}")
    unknown = sorted(content.keys() - set(_LISTS) - set(_TEXTS))
    if unknown:
        raise BadInput(f"unknown key {unknown[0]}", todo=f"known keys: {', '.join((*_TEXTS, *_LISTS))}")
    shape = content.get("shape", "ptfe")
    if shape not in _SHAPES:
        raise BadInput(f"shape is {shape!r}", todo=f"give one of {', '.join(_SHAPES)}")
    lists = {name: _numbers(name, content[name]) for name in _LISTS if name in content}
    texts = {name: str(content[name]) for name in ("name", "date", "note") if name in content}
    return WhiteCalibration(
        certificate=_certificate(lists),
        points=_points(lists),
        channel_nm=tuple(lists.get("channel_nm", np.empty(0)).tolist()),
        lambertian=shape == "lambertian",
        **texts,
    )


def _numbers(name: str, values: Any) -> Float:
    good = isinstance(values, list) and all(
        isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        for value in values
    )
    if not good:
        raise BadInput(f"{name} is not a list of numbers", todo="write it such as [1.0, 2.0]")
    return np.array(values, dtype=np.float64)


def _columns(lists: dict[str, Float], names: Sequence[str]) -> list[Float] | None:
    """Give lists that belong together: all there and of one length, or none."""
    have = [name for name in names if name in lists]
    if not have:
        return None
    lengths = {len(lists[name]) for name in have}
    if len(have) != len(names) or len(lengths) != 1 or not max(lengths):
        raise BadInput(f"{', '.join(names)} do not fit together", todo="give all of them, equally long")
    return [lists[name] for name in names]


def _certificate(lists: dict[str, Float]) -> Certificate | None:
    columns = _columns(lists, _LISTS[:3])
    return None if columns is None else checked_certificate(*columns)


def checked_certificate(nm: Float, rho: Float, u: Float) -> Certificate:
    """Put a certificate together, by ascending wavelength.

    Raises
    ------
    BadInput
        Repeated wavelengths, or values that are none of a white.
    """
    order = np.argsort(nm, kind="stable")
    fine = np.all(np.diff(nm[order]) > 0.0) and np.all((rho > 0.0) & (rho <= 1.05)) and np.all(u >= 0.0)
    if not fine or not np.all(nm > 0.0):
        what = "a certificate with repeated wavelengths, or with values that are none of a white"
        raise BadInput(what, todo="give wavelength in nm, reflectance (above 0 to 1), standard uncertainty")
    return Certificate(nm[order], rho[order], u[order])


def _points(lists: dict[str, Float]) -> Points | None:
    columns = _columns(lists, _LISTS[4:9])
    if columns is None:
        return None
    u_relative = lists.get("point_u_relative")
    if u_relative is not None and len(u_relative) != len(columns[0]):
        raise BadInput("point_u_relative does not fit the points", todo="give one for each")
    theta_i, phi_i, theta_o, phi_o, factor = columns
    return checked_points(Points(theta_i, phi_i, theta_o, phi_o, factor, u_relative))


def checked_points(points: Points) -> Points:
    """Pass points on.

    Raises
    ------
    BadInput
        An angle that is none above the horizon, a factor that is not positive.
    """
    lowest = np.concatenate([points.theta_i_deg, points.theta_o_deg])
    if np.any(lowest < 0.0) or np.any(lowest >= 90.0) or np.any(points.factor <= 0.0):
        what = "points with angles beyond 90 degrees from the normal, or factors that are not positive"
        raise BadInput(what, todo="give angles from the normal in degrees, and reflectance factors")
    return points


def save_white(calibration: WhiteCalibration, path: Path) -> None:
    """Write a white's calibration file, which `load_white` reads back equal.

    Raises
    ------
    BadInput, Refused
        It cannot be written; an earlier one stays.
    """
    import tomli_w

    content: dict[str, Any] = {
        "version": FORMAT_VERSION,
        "shape": _SHAPES[calibration.lambertian],
        "name": calibration.name,
        "date": calibration.date,
        "note": calibration.note,
        "channel_nm": list(calibration.channel_nm) or None,
    }
    if calibration.certificate is not None:
        parts = (calibration.certificate.nm, calibration.certificate.rho, calibration.certificate.u)
        content |= {name: part.tolist() for name, part in zip(_LISTS[:3], parts, strict=True)}
    points = calibration.points
    if points is not None:
        angles = (points.theta_i_deg, points.phi_i_deg, points.theta_o_deg, points.phi_o_deg)
        columns = zip(_LISTS[4:9], (*angles, points.factor), strict=True)
        content |= {name: column.tolist() for name, column in columns}
        if points.u_relative is not None:
            content["point_u_relative"] = points.u_relative.tolist()
    with whole_file(path) as file:
        text = tomli_w.dumps({name: value for name, value in content.items() if value is not None})
        file.write_text(text, encoding="utf-8")
