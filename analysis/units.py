"""Numbers that betray their unit: radians among degrees.

Laboratories measure on grids that are round in degrees. Angles that were written in radians and read as
degrees lie in a small corner, and multiplied by 180/pi they are round; angles in degrees are not, by chance,
all of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

POLAR_STEP_DEG, POLAR_SLACK_DEG = 0.5, 0.03
AZIMUTH_STEP_DEG, AZIMUTH_SLACK_DEG = 15.0, 0.03
FEWEST_POLAR = 4
"""Different polar angles from which on chance does not make all of them round."""
NEARLY_ALL = 0.95


def require_degrees(samples: xr.Dataset, where: str) -> None:
    """Refuse samples whose angles, all or one column of them, were radians taken as degrees.

    Parameters
    ----------
    samples : xarray.Dataset
        See `analysis.samples`.
    where : str
        Name used in the error.

    Raises
    ------
    BadInput
        Naming the angle, what stands there, and what it would be.
    """
    for side, name in (("wi", "i"), ("wo", "o")):
        theta, phi = (
            np.asarray(np.degrees(angle), np.float64)
            for angle in direction_to_spherical(samples[side].to_numpy())
        )
        for angle, column, radians in (
            ("theta", theta, _polar_is_radians(theta)),
            ("phi", phi, _azimuth_is_radians(phi)),
        ):
            if radians:
                seen = np.max(np.abs(column))
                raise BadInput(
                    f"{angle}_{name} looks like radians where degrees are meant: {seen:.4g} and the others "
                    f"are round as radians ({np.degrees(seen):.4g} deg)",
                    where=where,
                    todo="write all four angles in degrees",
                )


def _polar_is_radians(theta_deg: Array) -> bool:
    values = np.unique(np.round(theta_deg[theta_deg > 1e-6], 6))
    return values.size >= FEWEST_POLAR and _round_as_radians(
        values, 0.5 * np.pi, POLAR_STEP_DEG, POLAR_SLACK_DEG
    )


def _azimuth_is_radians(phi_deg: Array) -> bool:
    sizes = np.asarray(np.abs(phi_deg), dtype=np.float64)
    values = np.unique(np.round(sizes[sizes > 1e-6], 6))
    return values.size > 0 and _round_as_radians(values, 2.0 * np.pi, AZIMUTH_STEP_DEG, AZIMUTH_SLACK_DEG)


def _round_as_radians(values: Array, most: float, step_deg: float, slack_deg: float) -> bool:
    """Whether numbers lie within radians' range and are multiples of a step when taken as radians."""
    if values.max() > most + np.radians(slack_deg):
        return False
    turned = np.degrees(values)
    off = np.abs(turned - step_deg * np.round(turned / step_deg))
    return bool(np.mean(off < slack_deg) >= NEARLY_ALL)
