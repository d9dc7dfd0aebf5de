"""What speaks against a sensor's calibration: when it is made, and when it is used."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from rig.errors import Refused

if TYPE_CHECKING:
    from capture.characterise import SensorCharacter
    from capture.sensor import SensorModel

LARGEST_AGE_DAYS = 365
"""A calibration older than this is due: pixels turn hot over a year, gain hardly moves."""

LARGEST_WARMING_K = 8.0
"""Dark current doubles within so many kelvin (EMVA 1288 release 4, section 7.3; silicon: 6 to 8 K)."""

_SURE = 0.003
_APART = 0.01
_SIGMAS = 5.0
_STRAIGHT = 1.5
_BENT = 0.01


def doubts_of(character: SensorCharacter) -> list[str]:
    """Tell what a person should know before believing a characterisation.

    Parameters
    ----------
    character : SensorCharacter

    Returns
    -------
    list of str
        A line each; empty where nothing is odd.
    """
    found = []
    line = character.transfer
    if character.saturation is None:
        found.append("no frame saturates: the clip level is the files' claim, which is often wrong")
    if len(character.dark.exposure_s) < 2:
        found.append("darks of one exposure only: the dark current is unknown")
    if line.u_gain_dn_per_e > _SURE * line.gain_dn_per_e:
        share = 100.0 * line.u_gain_dn_per_e / line.gain_dn_per_e
        found.append(f"the gain is known to {share:.2g} % only: shoot more pairs of flats")
    for name, each in zip(character.channels, character.transfer_of, strict=True):
        apart = each.gain_dn_per_e - line.gain_dn_per_e
        if abs(apart) > max(_SIGMAS * each.u_gain_dn_per_e, _APART * line.gain_dn_per_e):
            share = 100.0 * apart / line.gain_dn_per_e
            found.append(f"channel {name} has {share:+.1f} % gain: the camera probably scaled its counts")
    if line.reduced_chi_square > _STRAIGHT:
        found.append(
            f"variance over mean is no straight line (chi-square {line.reduced_chi_square:.2g} a point): "
            "the counts are processed, or the light flickers within a frame"
        )
    worst = max((each.error for each in character.linearity), default=0.0)
    if worst > _BENT:
        share = 100.0 * worst
        found.append(f"the response bends by {share:.2g} %: exposure times are off, or it is not linear")
    return found


def require_camera(sensor: SensorModel, serial: str | None, iso: float | None, where: str) -> None:
    """Pass only if a calibration is of this camera at this setting; what is not stated cannot contradict.

    Parameters
    ----------
    sensor : SensorModel
    serial : str or None
        Of the camera in use.
    iso : float or None
        Its setting.
    where : str
        The calibration file, for the message.

    Raises
    ------
    Refused
        They differ.
    """
    pairs = (("camera", sensor.camera_serial, serial), ("ISO", sensor.iso, iso))
    for what, calibrated, used in pairs:
        if calibrated and used and calibrated != used:
            raise Refused(
                f"the calibration is of {what} {calibrated}, in use is {used}",
                where=where,
                todo="run gonio calibrate sensor with what is in use, or connect what was calibrated",
            )


def doubts_in_use(
    sensor: SensorModel, *, now: datetime | None = None, lamp_temperature_deg_c: float | None = None
) -> list[str]:
    """Tell what speaks against using a calibration here and now.

    Parameters
    ----------
    sensor : SensorModel
    now : datetime, optional
        With a time zone; default: the clock's.
    lamp_temperature_deg_c : float, optional
        Of the lamp head, before the lamp comes on.

    Returns
    -------
    list of str
        A line each, with what to do; empty where nothing does.
    """
    found = []
    todo = "run gonio calibrate sensor"
    made = _date(sensor.date)
    if made is not None:
        days = ((now or datetime.now(UTC)) - made).total_seconds() / 86_400.0
        if days > LARGEST_AGE_DAYS:
            found.append(f"the sensor's calibration is {days:.0f} days old: {todo}")
        elif days < -1.0:
            found.append(
                f"the sensor's calibration is dated {sensor.date}, in the future: set the clock, {todo}"
            )
    if lamp_temperature_deg_c is not None and sensor.lamp_temperature_deg_c is not None:
        warmer = lamp_temperature_deg_c - sensor.lamp_temperature_deg_c
        if abs(warmer) > LARGEST_WARMING_K:
            found.append(
                f"the machine is {warmer:+.0f} K off the temperature of the sensor's calibration, "
                f"its dark current differs by a factor of 2 or more: {todo}"
            )
    return found


def _date(text: str | None) -> datetime | None:
    """Read an ISO 8601 date; a text that is none says nothing."""
    try:
        made = datetime.fromisoformat(text or "")
    except ValueError:
        return None
    return made if made.tzinfo is not None else made.replace(tzinfo=UTC)
