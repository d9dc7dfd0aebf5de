"""What a recipe's steps work on: readings at nominal angles, their errors told apart by who shares them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.formats.doubts import ATTRIBUTE
from analysis.samples import make_samples
from analysis.samples import read as read_samples
from analysis.uncertainty import quadrature
from rig.angles import direction_to_spherical, spherical_to_direction, wrap
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    import xarray as xr

    from analysis.recipes.repeatability import Repeatability

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAME_ANGLE_RAD = 1e-7
"""Nominal angles closer than this are the same."""


ANGLES = {
    "theta_i": "incidence",
    "phi_i": "light's azimuth",
    "theta_o": "view",
    "phi_o": "view's azimuth",
}
"""The columns that are nominal angles, and their names for people."""


class Flag(IntFlag):
    """Why a reading may not be used."""

    SELF_SHADOW = 1
    """The detector's arm stands in the light's beam, or so near that the recipe drops the reading."""

    NOT_MEASURED = 2
    """A cell of a grid outside of the readings."""

    GRAZING = 4
    """Seen or lit along the surface or from behind it, or beyond the angle at which the recipe stops."""

    AS_READ = 8
    """Flagged by the file that it comes from."""


@dataclass(frozen=True)
class Readings:
    """Readings of one or more files, and what a recipe has made of them so far.

    Attributes
    ----------
    theta_i, phi_i, theta_o, phi_o : ndarray, shape (N,)
        Nominal angles of light and detector in radians. Azimuths stay as the instrument gives them, also at
        the pole, where directions would forget them.
    value : ndarray, shape (N, C)
        The reading; after the last step f_r in 1/sr.
    flags : ndarray of int, shape (N, C)
        0, or a sum of `Flag`.
    u_noise : ndarray, shape (N, C)
        Standard uncertainty that each reading has for itself.
    u_blank : ndarray, shape (N, C)
        Standard uncertainty that all readings with the same `blank_id` share.
    u_common : ndarray, shape (N, C)
        Standard uncertainty, one error for all readings.
    origin, blank_id, file : ndarray of int, shape (N,)
        Number of the reading, which its copies share with their whole noise; of the blank's reading (-1
        before it is subtracted); of the file.
    channels : tuple of str
    wavelength_nm : tuple of float, optional
    files : tuple of str
        Names of the files.
    sideways_rad, u_sideways_rad : float
        How far the peak lies beside the plane of incidence, to be taken out when directions are interpolated.
    repeatability : Repeatability, optional
        Found where files of one sample were averaged.
    notes : tuple of str
        What the steps have to tell the person.
    doubts : str
        Why the file may be cut short or damaged, where its reader saw signs of it.
    """

    theta_i: Array
    phi_i: Array
    theta_o: Array
    phi_o: Array
    value: Array
    flags: Integers
    u_noise: Array
    u_blank: Array
    u_common: Array
    origin: Integers
    blank_id: Integers
    file: Integers
    channels: tuple[str, ...]
    wavelength_nm: tuple[float, ...] | None = None
    files: tuple[str, ...] = ()
    sideways_rad: float = 0.0
    u_sideways_rad: float = 0.0
    repeatability: Repeatability | None = None
    notes: tuple[str, ...] = ()
    doubts: str = ""

    def __len__(self) -> int:
        return len(self.value)

    @property
    def usable(self) -> Bools:
        """Where there is a value without flags, shape (N, C)."""
        return np.asarray((self.flags == 0) & np.isfinite(self.value))

    @property
    def between(self) -> Array:
        """Azimuth from the light to the detector in (-pi, pi], shape (N,)."""
        return np.asarray(wrap(self.phi_o - self.phi_i))

    def rows(self, chosen: NDArray[np.intp] | Bools) -> Readings:
        """Choose readings."""
        return self.with_columns({name: getattr(self, name)[chosen] for name in PER_READING})

    def with_columns(self, columns: Mapping[str, Any]) -> Readings:
        """Replace columns of `PER_READING`."""
        return replace(self, **columns)

    def scaled(self, factor: Array | float) -> Readings:
        """Multiply values and uncertainties; `factor` broadcasts against (N, C)."""
        size = np.abs(factor)
        return replace(
            self,
            value=self.value * factor,
            u_noise=self.u_noise * size,
            u_blank=self.u_blank * size,
            u_common=self.u_common * size,
        )

    def noted(self, note: str) -> Readings:
        """Add a note for the person."""
        return replace(self, notes=(*self.notes, note))


PER_READING = (*ANGLES, "value", "flags", "u_noise", "u_blank", "u_common", "origin", "blank_id", "file")
"""The columns of `Readings`: what has one entry for each reading."""


def make_readings(
    angles: Sequence[Array],
    value: Array,
    *,
    flags: Integers | None = None,
    u_noise: Array | None = None,
    u_common: Array | None = None,
    channels: Sequence[str] = ("RT",),
    wavelength_nm: Sequence[float] | None = None,
    name: str = "",
) -> Readings:
    """Make the readings of one file.

    Parameters
    ----------
    angles : sequence of four ndarray, shape (N,)
        theta_i, phi_i, theta_o, phi_o in radians.
    value : ndarray, shape (N, C)
        The readings.
    flags, u_noise, u_common : ndarray, shape (N, C), optional
        As in `Readings`.
    channels, wavelength_nm : sequence, optional
        Their names and, where known, wavelengths.
    name : str
        The file's name.
    """
    zeros = np.zeros(value.shape)
    count = len(value)
    theta_i, phi_i, theta_o, phi_o = (np.asarray(angle, dtype=np.float64) for angle in angles)
    own = np.zeros(value.shape, dtype=np.int64) if flags is None else flags
    outside = (np.minimum(np.cos(theta_i), np.cos(theta_o)) <= SAME_ANGLE_RAD)[:, None]
    return Readings(
        theta_i,
        phi_i,
        theta_o,
        phi_o,
        value,
        own | np.where(outside, int(Flag.GRAZING), 0),
        zeros if u_noise is None else u_noise,
        zeros,
        zeros if u_common is None else u_common,
        np.arange(count),
        np.full(count, -1),
        np.zeros(count, dtype=np.int64),
        tuple(channels),
        None if wavelength_nm is None else tuple(wavelength_nm),
        (name,),
    )


def read_readings(path: Path, *, only: str = "", **options: Any) -> Readings:
    """Read a raw file: as its instrument wrote it where the format has that, else by its samples' values.

    Parameters
    ----------
    path : Path
        The file.
    only : str
        Name of the one format that it may be; empty: any.
    **options
        What its format offers beside, as in `analysis.samples.read`.

    Raises
    ------
    BadInput
        If the file is missing, damaged, of no known format, or not of the only one allowed.
    """
    from analysis.formats import recognise

    module = recognise(path)
    if only not in {"", module.NAME}:
        raise BadInput(
            f"is {module.NAME}, and the recipe is for {only}", where=str(path), todo="choose another recipe"
        )
    as_readings = getattr(module, "as_readings", None)
    given = [name for name, value in options.items() if value is not None]
    if as_readings is not None and given:
        raise BadInput(f"{given[0]} means nothing to {module.NAME}", where=str(path), todo="leave it out")
    if as_readings is not None:
        readings: Readings = as_readings(path)
        return readings
    samples = read_samples(path, **options)
    value = samples["f_r"].to_numpy()
    flags = np.where(samples["flags"].to_numpy() == 0, 0, int(Flag.AS_READ))
    u_all = samples["u_f_r"].to_numpy() if "u_f_r" in samples else np.zeros(value.shape)
    u_common = samples["u_reference"].to_numpy() if "u_reference" in samples else np.zeros(value.shape)
    known = samples.coords.get("wavelength_nm")
    made = make_readings(
        (
            *direction_to_spherical(samples["wi"].to_numpy()),
            *direction_to_spherical(samples["wo"].to_numpy()),
        ),
        value,
        flags=flags,
        u_noise=np.sqrt(np.maximum(u_all**2 - u_common**2, 0.0)),
        u_common=u_common,
        channels=[str(name) for name in samples["channel"].to_numpy()],
        wavelength_nm=None if known is None else [float(w) for w in known.to_numpy()],
        name=path.name,
    )
    return replace(made, doubts=str(samples.attrs.get(ATTRIBUTE, "")))


def joined(parts: Sequence[Readings]) -> Readings:
    """Put the readings of several files of one sample together.

    Raises
    ------
    BadInput
        If their channels differ.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.channels != first.channels:
            raise BadInput(
                f"has the channels {', '.join(part.channels)}, {first.files[0]} {', '.join(first.channels)}",
                where=part.files[0],
                todo="reduce files of the same kind together",
            )
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in PER_READING}
    columns["origin"] = np.arange(len(columns["value"]))
    columns["file"] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return replace(first.with_columns(columns), files=tuple(name for part in parts for name in part.files))


def with_floor(readings: Readings, deviation: Callable[[Array], Array], count: Array | float) -> Readings:
    """Raise the independent part so that no reading claims less than repeats of it agree.

    Parameters
    ----------
    readings : Readings
        Means of `count` repeats.
    deviation : callable
        Standard deviation of one of them by its level, in the unit of the readings.
    count : ndarray or float
        Broadcasts against (N, C); less than 1 counts as 1.
    """
    floor = deviation(readings.value) / np.sqrt(np.maximum(count, 1.0))
    rest = np.square(readings.u_blank) + np.square(readings.u_common)
    needed = np.sqrt(np.maximum(np.square(floor) - rest, 0.0))
    raised = np.maximum(readings.u_noise, np.where(np.isfinite(needed), needed, 0.0))
    return replace(readings, u_noise=raised)


def to_samples(readings: Readings, *, source: str) -> xr.Dataset:
    """Make samples of what the last step left; uncertainties only where some step stated one.

    The blank's errors go with the noise: after the average each cell has blank readings of its own.
    """
    independent = quadrature(readings.u_noise, readings.u_blank)
    return make_samples(
        spherical_to_direction(readings.theta_i, readings.phi_i),
        spherical_to_direction(readings.theta_o, readings.phi_o),
        readings.value,
        channels=readings.channels,
        wavelength_nm=readings.wavelength_nm,
        flags=readings.flags,
        source=source,
        u_noise=independent if np.any(independent > 0.0) else None,
        u_reference=readings.u_common if np.any(readings.u_common > 0.0) else None,
    )


def identities(*columns: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Give equal rows of angles one number, in the order in which they first appear.

    Returns
    -------
    first : ndarray, shape (M,)
        Row in which each number first appears.
    number : ndarray, shape (N,)
        Number of each row.
    """
    keys = np.stack([np.round(column / SAME_ANGLE_RAD) for column in columns], axis=-1)
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[number.ravel()]
