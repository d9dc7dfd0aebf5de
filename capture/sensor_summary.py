"""A sensor's quantities as a person reads them, and everything that is kept of a characterisation.

Names and symbols are those of EMVA 1288 release 4. What needs a calibrated photon count (quantum efficiency,
thresholds in photons) is not among them.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.sensor import save_sensor
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from capture.characterise import SensorCharacter
    from capture.sensor import SensorModel

SUMMARY_FILE, MAPS_FILE, MODEL_FILE = "sensor.json", "maps.npz", "sensor.toml"


@dataclass(frozen=True)
class Quantity:
    """One number of the data sheet.

    Attributes
    ----------
    key : str
        Its name in the JSON file.
    symbol, name : str
    value : float
        NaN where the frames do not tell.
    u : float or None
        Standard uncertainty, where it is known.
    unit : str
    """

    key: str
    symbol: str
    name: str
    value: float
    u: float | None
    unit: str


def quantities(character: SensorCharacter) -> list[Quantity]:
    """List what a characterisation found.

    Parameters
    ----------
    character : SensorCharacter

    Returns
    -------
    list of Quantity
    """
    line = character.transfer
    gain, u_gain = line.gain_dn_per_e, line.u_gain_dn_per_e
    dark_e = math.sqrt(max(line.floor_dn2, 0.0)) / gain
    full_e, least_e = character.saturation_e, character.threshold_e
    u_full_e = full_e * u_gain / gain
    linear = [each.error for each in character.linearity]
    bent = [each.largest for each in character.linearity]
    return [
        Quantity("gain_dn_per_e", "K", "overall system gain", gain, u_gain, "DN/e⁻"),
        Quantity("inverse_gain_e_per_dn", "1/K", "its inverse", 1.0 / gain, u_gain / gain**2, "e⁻/DN"),
        Quantity(
            "read_noise_dn", "", "read noise without rounding", line.read_noise_dn, line.u_read_noise_dn, "DN"
        ),
        Quantity(
            "read_noise_e",
            "",
            "the same",
            line.read_noise_dn / gain,
            math.hypot(line.u_read_noise_dn, line.read_noise_dn * u_gain / gain) / gain,
            "e⁻",
        ),
        Quantity("dark_noise_e", "σ_d", "temporal dark noise, rounding included", dark_e, None, "e⁻"),
        Quantity(
            "dark_current_e_per_s",
            "μ_I,mean",
            "dark current, from the mean",
            character.dark_current_dn_per_s / gain,
            character.u_dark_current_dn_per_s / gain,
            "e⁻/s",
        ),
        Quantity(
            "dark_current_by_variance_e_per_s",
            "μ_I,var",
            "dark current, from the variance",
            character.dark_current_by_variance_e_per_s,
            None,
            "e⁻/s",
        ),
        Quantity("saturation_e", "μ_e,sat", "saturation capacity", full_e, u_full_e, "e⁻"),
        Quantity("threshold_e", "μ_e,min", "absolute sensitivity threshold", least_e, None, "e⁻"),
        Quantity("snr_max", "SNR_max", "largest signal-to-noise ratio", math.sqrt(full_e), None, ""),
        Quantity("dynamic_range", "DR", "dynamic range", full_e / least_e, None, ""),
        Quantity("dynamic_range_db", "", "the same", 20.0 * math.log10(full_e / least_e), None, "dB"),
        Quantity("linearity_error_percent", "LE", "linearity error", _percent(linear), None, "%"),
        Quantity("linearity_largest_percent", "", "largest deviation", _percent(bent), None, "%"),
        Quantity("prnu_percent", "PRNU", "unequal response", 100.0 * character.prnu, None, "%"),
        Quantity("dsnu_e", "DSNU", "unequal dark level", character.dsnu_dn / gain, None, "e⁻"),
        Quantity("hot_pixels", "", "hot pixels", float(character.dark.hot.sum()), None, ""),
    ]


def _percent(values: Sequence[float]) -> float:
    return 100.0 * max(values, default=math.nan)


def summary(character: SensorCharacter, model: SensorModel, doubts: Sequence[str]) -> dict[str, Any]:
    """Everything as plain values; see `SUMMARY_FILE`."""
    line = character.transfer
    return {
        "gonio_sensor": 1,
        "date": model.date,
        "camera": {
            "serial": character.camera_serial,
            "model": character.camera_model,
            "iso": character.iso,
            "height_px": character.dark.shape[0],
            "width_px": character.dark.shape[1],
        },
        "quantities": {
            item.key: {"value": _plain(item.value), "u": _plain(item.u), "unit": item.unit}
            for item in quantities(character)
        },
        "channels": {
            name: {
                "gain_dn_per_e": each.gain_dn_per_e,
                "u_gain_dn_per_e": each.u_gain_dn_per_e,
                "clip_dn": clip,
            }
            for name, each, clip in zip(
                character.channels, character.transfer_of, character.clip_dn, strict=True
            )
        },
        "black_dn": list(character.black_dn),
        "quantisation_step_dn": line.quantisation_step_dn,
        "transfer": {
            "points": line.points,
            "reduced_chi_square": line.reduced_chi_square,
            "covariance": line.covariance,
        },
        "darks": [
            {"exposure_s": seconds, "frames": number}
            for seconds, number in zip(character.dark.exposure_s, character.dark.frames, strict=True)
        ],
        "doubts": list(doubts),
    }


def _plain(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def write_summary(
    folder: Path, character: SensorCharacter, model: SensorModel, doubts: Sequence[str]
) -> None:
    """Write summary, maps (bias, dark rate, hot pixels) and the calibration file into a folder.

    Parameters
    ----------
    folder : Path
        Exists.
    character : SensorCharacter
    model : SensorModel
    doubts : sequence of str

    Raises
    ------
    BadInput, Refused
        A file cannot be written; earlier ones stay.
    """
    with whole_file(folder / SUMMARY_FILE) as file:
        text = json.dumps(summary(character, model, doubts), indent=2, ensure_ascii=False)
        file.write_text(text + "\n", encoding="utf-8")
    with whole_file(folder / MAPS_FILE) as file, file.open("wb") as stream:
        np.savez_compressed(
            stream,
            bias_dn=character.dark.bias_dn,
            dark_rate_dn_per_s=character.dark.rate_dn_per_s,
            hot=character.dark.hot,
        )
    with whole_file(folder / MODEL_FILE) as file:
        save_sensor(model, file)
