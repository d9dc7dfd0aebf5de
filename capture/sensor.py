"""The noise model of a linear sensor, and its calibration file `calibration/sensor.toml`.

The variance of one count above black, in DN squared, is (EMVA 1288 release 4, section 2.2; Hasinoff et al.
2010, eq. 1)

    var(y) = K (y_light + y_dark) + s_read^2 + q^2 / 12

with K the gain in DN per electron, s_read the read noise without quantisation, and q the quantisation step.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture.linearity import Bend
from rig.errors import BadInput

if TYPE_CHECKING:
    import os

_POSITIVE = "a number above 0"
_NOT_NEGATIVE = "a number, 0 or more"


@dataclass(frozen=True)
class SensorModel:
    """Gain, noise and limits of a linear sensor at one setting (ISO, temperature).

    Attributes
    ----------
    gain_dn_per_e : float
        K, DN per electron; above 0.
    read_noise_dn : float
        Standard deviation of the noise without light, dark current and quantisation, in DN; 0 or more.
    clip_dn : float or tuple of float
        Count at which the sensor clips, black included, in DN: one for all, or one per channel (R, G, B).
    black_dn : tuple of float, optional
        Black level at the four positions of the CFA cell, row by row, in DN; None: as each file states.
    dark_current_dn_per_s : float
        Mean dark signal of an ordinary pixel, DN/s; 0 or more.
    quantisation_step_dn : float
        Distance between neighbouring codes in DN; 1 unless the counts were rescaled; 0 for analogue values.
    camera_serial, camera_model : str, optional
        The camera that was calibrated.
    iso : float, optional
        The ISO setting it was calibrated at.
    date : str, optional
        When, ISO 8601.
    note : str, optional
        How, in words.
    u_gain_dn_per_e, u_read_noise_dn : float, optional
        Standard uncertainties of gain and read noise.
    bend : tuple of float, optional
        Coefficients of the response's bend, see `capture.linearity.Bend`; with them `bend_range_dn` and
        `bend_error`.
    linearity_error : float, optional
        Mean relative deviation of the response from a straight line (EMVA 1288's LE).
    prnu : float, optional
        Relative standard deviation of the pixels' responses.
    lamp_temperature_deg_c : float, optional
        Of the lamp head before the lamp first came on, which is the room's after a pause.
    truncated : bool
        Whether counts are cut to whole steps, not rounded: those of lit pixels are half a step low.

    Raises
    ------
    BadInput
        A value is out of its range.
    """

    gain_dn_per_e: float
    read_noise_dn: float
    clip_dn: float | tuple[float, ...]
    black_dn: tuple[float, ...] | None = None
    dark_current_dn_per_s: float = 0.0
    quantisation_step_dn: float = 1.0
    camera_serial: str | None = None
    camera_model: str | None = None
    iso: float | None = None
    date: str | None = None
    note: str | None = None
    u_gain_dn_per_e: float | None = None
    u_read_noise_dn: float | None = None
    linearity_error: float | None = None
    bend: tuple[float, ...] | None = None
    bend_range_dn: float | None = None
    bend_error: float | None = None
    prnu: float | None = None
    lamp_temperature_deg_c: float | None = None
    truncated: bool = False

    def __post_init__(self) -> None:
        _check(self.gain_dn_per_e > 0, "gain_dn_per_e", self.gain_dn_per_e, _POSITIVE)
        for name in ("read_noise_dn", "dark_current_dn_per_s", "quantisation_step_dn"):
            _check(getattr(self, name) >= 0, name, getattr(self, name), _NOT_NEGATIVE)
        for name in ("u_gain_dn_per_e", "u_read_noise_dn", "linearity_error", "bend_error", "prnu"):
            value = getattr(self, name)
            _check(value is None or value >= 0, name, value, _NOT_NEGATIVE)
        parts = [self.bend is None, self.bend_range_dn is None, self.bend_error is None]
        _check(all(parts) or not any(parts), "bend", self.bend, "together with bend_range_dn and bend_error")
        bent_dn = self.bend_range_dn
        _check(bent_dn is None or bent_dn > 0, "bend_range_dn", bent_dn, _POSITIVE)
        clips = self.clip_dn if isinstance(self.clip_dn, tuple) else (self.clip_dn,)
        _check(len(clips) > 0 and all(clip > 0 for clip in clips), "clip_dn", self.clip_dn, _POSITIVE)
        if self.black_dn is not None:
            four = len(self.black_dn) == 4 and all(math.isfinite(black) for black in self.black_dn)
            _check(four, "black_dn", self.black_dn, "four numbers, one per CFA position, row by row")
            _check(max(self.black_dn) < min(clips), "clip_dn", self.clip_dn, "a number above black_dn")

    @property
    def response(self) -> Bend | None:
        """How the response departs from proportion, None where that is not known."""
        if self.bend is None or self.bend_range_dn is None or self.bend_error is None:
            return None
        return Bend(self.bend_range_dn, self.bend, self.bend_error)

    @property
    def floor_variance_dn2(self) -> float:
        """Variance of a count without light and dark current, DN^2: read noise and quantisation."""
        return self.read_noise_dn**2 + self.quantisation_step_dn**2 / 12.0

    def clip_of_channel(self, channel: int) -> float:
        """Clip level of one channel in DN, black included.

        Raises
        ------
        BadInput
            The model holds clip levels for other channels.
        """
        if not isinstance(self.clip_dn, tuple):
            return self.clip_dn
        if len(self.clip_dn) == 1:
            return self.clip_dn[0]
        if not 0 <= channel < len(self.clip_dn):
            what = f"the sensor model has {len(self.clip_dn)} clip levels, none for channel {channel}"
            raise BadInput(what, todo="give clip_dn once, or once for each channel of the camera")
        return self.clip_dn[channel]


def _check(fine: bool, name: str, value: object, wanted: str) -> None:
    if not fine:
        raise BadInput(
            f"{name} is {value!r}, expected {wanted}", where="sensor model", todo="correct the value"
        )


_ELECTRON_KEYS = {"read_noise_e": "read_noise_dn", "dark_current_e_per_s": "dark_current_dn_per_s"}
_TEXT_KEYS = frozenset({"camera_serial", "camera_model", "date", "note"})
_SWITCH_KEYS = frozenset({"truncated"})
_LIST_KEYS = frozenset({"clip_dn", "black_dn", "bend"})
_REQUIRED_KEYS = ("gain_dn_per_e", "read_noise_dn", "clip_dn")
FORMAT_VERSION = 1
"""Version of the calibration file that `save_sensor` writes, its key `version`."""


def load_sensor(path: str | os.PathLike[str]) -> SensorModel:
    """Read a sensor's calibration file.

    The keys are the attributes of `SensorModel`; `read_noise_e` and `dark_current_e_per_s` may stand for
    `read_noise_dn` and `dark_current_dn_per_s`; one `black_dn` stands for all four positions.

    Parameters
    ----------
    path : path
        A TOML file, usually `calibration/sensor.toml` beside `rig.toml`.

    Returns
    -------
    SensorModel

    Raises
    ------
    BadInput
        The file is missing, is not TOML, lacks a value, or has an unknown or an impossible one.
    """
    path = Path(path)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadInput("no such file", where=str(path), todo="give the sensor's calibration file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"not TOML ({error})", where=str(path), todo="correct the file") from None
    try:
        return _model(values)
    except BadInput as error:
        raise BadInput(error.what, where=str(path), todo=error.todo) from None


def _model(values: dict[str, Any]) -> SensorModel:
    names = {item.name for item in fields(SensorModel)}
    if values.pop("version", FORMAT_VERSION) != FORMAT_VERSION:
        raise BadInput("its version is not known", todo=f"this gonio reads version {FORMAT_VERSION}")
    for key in values.keys() - names - _ELECTRON_KEYS.keys():
        nearest = difflib.get_close_matches(key, [*names, *_ELECTRON_KEYS], n=1)
        hint = f"did you mean {nearest[0]}?" if nearest else f"known keys: {', '.join(sorted(names))}"
        raise BadInput(f"unknown key {key}", todo=hint)
    known = {key: _value(key, value) for key, value in values.items()}
    for key, name in _ELECTRON_KEYS.items():
        if key in known:
            if name in known:
                raise BadInput(f"both {key} and {name} are given", todo="give one of them")
            known[name] = known.pop(key) * known.get("gain_dn_per_e", math.nan)
    missing = [name for name in _REQUIRED_KEYS if name not in known]
    if missing:
        raise BadInput(f"{missing[0]} is missing", todo="add it, or calibrate the sensor")
    return SensorModel(**known)


def _value(key: str, value: Any) -> Any:
    if key in _TEXT_KEYS:
        return str(value)
    if key in _SWITCH_KEYS:
        _check(isinstance(value, bool), key, value, "true or false")
        return value
    if key in _LIST_KEYS and isinstance(value, list):
        return tuple(_number(key, item) for item in value)
    number = _number(key, value)
    return (number,) * 4 if key == "black_dn" else number


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadInput(f"{key} is {value!r}, expected a number", todo="correct the value")
    return float(value)


def save_sensor(sensor: SensorModel, path: str | os.PathLike[str]) -> None:
    """Write a sensor's calibration file, which `load_sensor` reads back equal.

    Parameters
    ----------
    sensor : SensorModel
        What to write; attributes that are None are left out.
    path : path
        The TOML file, replaced where it exists.
    """
    import tomli_w

    values = {item.name: getattr(sensor, item.name) for item in fields(sensor)}
    known = {name: value for name, value in values.items() if value is not None}
    Path(path).write_text(tomli_w.dumps({"version": FORMAT_VERSION, **known}), encoding="utf-8")
