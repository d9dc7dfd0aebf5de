"""Angles and values of a table as its format declares them, before anything is believed of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.formats.doubts import ATTRIBUTE
from rig.angles import direction_to_spherical, spherical_to_direction

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

SOLID_ANGLES = ("source_solid_angle_sr", "receiver_solid_angle_sr")
HISTORY = ("recipe", "recipe_source", "recipe_files", "recipe_steps", "reading", "reading_words", ATTRIBUTE)
"""Attributes of samples that stay true of them under another reading."""
COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o", "f_r")
PER_SAMPLE = ("u_f_r", "flags")
"""Facts that have one entry for each sample."""
HORIZON = 1e-9
"""Angle from the horizon, in radians, within which a direction counts as on it."""


@dataclass(frozen=True, eq=False)
class AngleTable:
    """Angles as declared, before anything is believed of them, and values.

    Attributes
    ----------
    theta_i, phi_i, theta_o, phi_o : ndarray, shape (N,)
        Radians, as the file's format declares its numbers; any size, and polar angles may have a sign.
    f_r : ndarray, shape (N, C)
        Values as declared, 1/sr.
    facts : dict
        What else `analysis.samples.make_samples` may be told: channels, wavelengths, uncertainty, flags.
    attributes : dict
        What the samples' file says of how they came about, and of doubts in it.
    """

    theta_i: Array
    phi_i: Array
    theta_o: Array
    phi_o: Array
    f_r: Array
    facts: dict[str, Any] = field(default_factory=dict)
    attributes: dict[str, str] = field(default_factory=dict)

    @property
    def wi(self) -> Array:
        """Directions to the light, shape (N, 3)."""
        return spherical_to_direction(self.theta_i, self.phi_i)

    @property
    def wo(self) -> Array:
        """Directions to the camera, shape (N, 3)."""
        return spherical_to_direction(self.theta_o, self.phi_o)

    def possible(self) -> NDArray[np.bool_]:
        """Whether both polar angles of a sample (N,) are angles above a surface."""
        largest = np.maximum(np.abs(self.theta_i), np.abs(self.theta_o))
        return np.asarray(largest < np.pi / 2.0 - HORIZON)

    def rows(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> AngleTable:
        """Return some samples, with what is known of each, and all other facts."""
        facts = {name: each[chosen] if name in PER_SAMPLE else each for name, each in self.facts.items()}
        columns = {name: getattr(self, name)[chosen] for name in COLUMNS}
        return replace(self, **columns, facts=facts)

    def scaled(self, factor: Array) -> AngleTable:
        """Multiply values, and the uncertainties that are stated of them, by a factor (N, 1) or (N, C)."""
        facts = dict(self.facts)
        if "u_f_r" in facts:
            facts["u_f_r"] = facts["u_f_r"] * np.abs(factor)
        return replace(self, f_r=self.f_r * factor, facts=facts)


def table_of(samples: xr.Dataset) -> AngleTable:
    """Return the angles of samples whose directions are already vectors."""
    (theta_i, phi_i), (theta_o, phi_o) = (
        direction_to_spherical(samples[name].to_numpy()) for name in ("wi", "wo")
    )
    facts = {
        "channels": [str(name) for name in samples["channel"].to_numpy()],
        "source": str(samples.attrs.get("source", "")),
        **{name: float(samples.attrs.get(name, np.nan)) for name in SOLID_ANGLES},
        **{name: samples[name].to_numpy() for name in ("u_f_r", "flags", "wavelength_nm") if name in samples},
    }
    attributes = {name: str(samples.attrs[name]) for name in HISTORY if name in samples.attrs}
    return AngleTable(theta_i, phi_i, theta_o, phi_o, samples["f_r"].to_numpy(), facts, attributes)
