"""BRDF samples as one xarray Dataset: made, read from any known format, written, narrowed for a fit.

Dimensions `sample`, `channel`, `xyz` (and `joint` where the pose's uncertainty is known). Variables:

=============== ================== ===== =======================================================
name            dimensions         unit  meaning
=============== ================== ===== =======================================================
wi, wo          sample, xyz        1     directions to light and camera, away from the surface
f_r             sample, channel    1/sr  BRDF, no cosine inside; NaN where there is no value
flags           sample, channel    1     0 where f_r may be used; else the writer's reasons
u_f_r           sample, channel    1/sr  standard uncertainty (k = 1): all below that is in 1/sr
u_noise         sample, channel    1/sr  independent from sample to sample
u_binning       sample, channel    1/sr  independent from sample to sample
u_white         sample, channel    1/sr  one error in each `white_group` and channel
white_group     sample             1     number of the group
u_reference     sample, channel    1/sr  one error for the session and all channels: white's rho
u_lamp          sample, channel    1/sr  one error for each pose and all channels: drift of the light
u_linearity     sample, channel    1/sr  one error for the session and all channels: bent response
u_stray         sample, channel    1/sr  one error for the session and all channels: stray light
u_flat          sample, channel    1/sr  one error in each `flat_group`, all channels: flat field
u_distortion    sample, channel    1/sr  one error in each `flat_group`, all channels: lens distortion
u_drift         sample, channel    1/sr  one error for the session: drift that only references found
flat_group      sample             1     number of the group: a place in the picture
u_repeatability sample, channel    1/sr  what repeats of the measurement differ by; no weight of fits
pose            sample             1     number of the pose
d_wi, d_wo      sample, joint, xyz 1/rad change of the directions per radian of each joint
u_joint_rad     joint              rad   uncertainty of each joint, one error in each `joint_group`
joint_group     sample, joint      1     number of the group, the encoder's step; without it the pose
=============== ================== ===== =======================================================

Only the first three are required. Coordinates: `channel` (names) and, where known, `wavelength_nm` (channel).
Attributes: `conventions`, `cosine`, `source_solid_angle_sr`, `receiver_solid_angle_sr` (NaN where not known),
`source`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.uncertainty import IN_F, quadrature
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from numpy.typing import ArrayLike, NDArray

    from analysis.formats.loss import Loss

CONVENTIONS = (
    "wi points to the light, wo to the camera; unit vectors away from the surface in the sample frame: "
    "right-handed, +z the normal, +x towards the mark; uncertainties are standard (k = 1)"
)
COSINE = "not included"
UNITS = {
    "wi": "1",
    "wo": "1",
    "f_r": "1/sr",
    "u_f_r": "1/sr",
    "flags": "1",
    "u_noise": "1/sr",
    "u_white": "1/sr",
    "u_reference": "1/sr",
    "u_binning": "1/sr",
    "u_lamp": "1/sr",
    "u_linearity": "1/sr",
    "u_stray": "1/sr",
    "u_flat": "1/sr",
    "u_distortion": "1/sr",
    "u_drift": "1/sr",
    "u_repeatability": "1/sr",
    "white_group": "1",
    "flat_group": "1",
    "pose": "1",
    "d_wi": "1/rad",
    "d_wo": "1/rad",
    "u_joint_rad": "rad",
    "joint_group": "1",
}
DIMENSIONS: dict[str, tuple[str, ...]] = {
    "wi": ("sample", "xyz"),
    "wo": ("sample", "xyz"),
    "white_group": ("sample",),
    "flat_group": ("sample",),
    "pose": ("sample",),
    "d_wi": ("sample", "joint", "xyz"),
    "d_wo": ("sample", "joint", "xyz"),
    "u_joint_rad": ("joint",),
    "joint_group": ("sample", "joint"),
}
PER_CHANNEL = ("sample", "channel")
INTEGERS = ("flags", "white_group", "flat_group", "pose", "joint_group")
UNIT_TOLERANCE = 1e-6
EXACT = 1e-12


def make_samples(
    wi: ArrayLike,
    wo: ArrayLike,
    f_r: ArrayLike,
    *,
    channels: Sequence[str] | None = None,
    wavelength_nm: ArrayLike | None = None,
    source_solid_angle_sr: float = np.nan,
    receiver_solid_angle_sr: float = np.nan,
    source: str = "",
    **variables: ArrayLike | None,
) -> xr.Dataset:
    """Make a Dataset of samples.

    Parameters
    ----------
    wi, wo : array_like, shape (N, 3)
        Unit directions to the light and to the camera, in the sample frame.
    f_r : array_like, shape (N, C) or (N,)
        BRDF in 1/sr.
    channels : sequence of str, optional
        Names of the channels; by default the wavelengths, or "0", "1", ...
    wavelength_nm : array_like, shape (C,), optional
        Wavelength of each channel.
    source_solid_angle_sr, receiver_solid_angle_sr : float
        Solid angles of lamp and camera aperture as seen from the sample; NaN where not known.
    source : str
        Where the samples come from.
    **variables : array_like or None
        Any other variable of the table above; None is left out. `u_f_r` is the quadrature of the columns in
        1/sr unless it is given.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    BadInput
        If shapes do not agree, a direction is not a unit vector, an uncertainty is negative, or a name is
        unknown.
    """
    import xarray as xr

    values = np.asarray(f_r, dtype=np.float64)
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2:
        raise BadInput(f"needs shape (samples, channels), not {values.shape}", where="f_r")
    count, channel_count = values.shape
    given = {name: value for name, value in variables.items() if value is not None}
    unknown = sorted(set(given) - set(UNITS))
    if unknown:
        raise BadInput(f"unknown variable {unknown[0]}", todo=f"known ones: {', '.join(UNITS)}")
    columns = {name: np.asarray(given[name], dtype=np.float64) for name in IN_F if name in given}
    if columns and "u_f_r" not in given:
        given["u_f_r"] = quadrature(*columns.values())
    given.setdefault("flags", np.zeros(values.shape, dtype=np.int64))
    data = {"wi": _directions("wi", wi, count), "wo": _directions("wo", wo, count), "f_r": values}
    data |= {name: _column(name, value, count, channel_count) for name, value in given.items()}
    wavelengths = None if wavelength_nm is None else np.asarray(wavelength_nm, dtype=np.float64)
    names = _channel_names(channels, wavelengths, channel_count)
    dataset = xr.Dataset(
        {
            name: (DIMENSIONS.get(name, PER_CHANNEL), value, {"units": UNITS[name]})
            for name, value in data.items()
        },
        coords={"channel": names, "xyz": ["x", "y", "z"]},
        attrs={
            "conventions": CONVENTIONS,
            "cosine": COSINE,
            "source_solid_angle_sr": float(source_solid_angle_sr),
            "receiver_solid_angle_sr": float(receiver_solid_angle_sr),
            "source": source,
        },
    )
    if wavelengths is not None:
        dataset = dataset.assign_coords(wavelength_nm=("channel", wavelengths, {"units": "nm"}))
    return dataset


def _channel_names(names: Sequence[str] | None, wavelengths: Any, count: int) -> list[str]:
    if wavelengths is not None and wavelengths.shape != (count,):
        raise BadInput(f"{count} channels, but shape {wavelengths.shape}", where="wavelength_nm")
    if names is None:
        return [str(i) for i in range(count)] if wavelengths is None else [f"{w:g} nm" for w in wavelengths]
    if len(names) != count:
        raise BadInput(f"{count} channels, but {len(names)} names", where="channels")
    return [str(name) for name in names]


def _directions(name: str, value: ArrayLike, count: int) -> NDArray[np.float64]:
    directions = np.asarray(value, dtype=np.float64)
    if directions.shape != (count, 3):
        raise BadInput(f"needs shape ({count}, 3), not {directions.shape}", where=name)
    x, y, z = directions.T
    length = np.sqrt(x * x + y * y + z * z)
    wrong = np.flatnonzero(~(np.abs(length - 1.0) <= UNIT_TOLERANCE))
    if wrong.size:
        raise BadInput(
            f"sample {wrong[0]} has length {length[wrong[0]]:g}, not 1",
            where=name,
            todo="pass unit vectors that point away from the surface",
        )
    # What is unit to the last digits stays as it is: reading back what was written must change nothing.
    sloppy = np.abs(length - 1.0) > EXACT
    if not sloppy.any():
        return directions
    return np.where(sloppy[:, None], directions / length[:, None], directions)


def _column(name: str, value: ArrayLike, count: int, channels: int) -> NDArray[Any]:
    kind = np.int64 if name in INTEGERS else np.float64
    column = np.asarray(value, dtype=kind)
    dimensions = DIMENSIONS.get(name, PER_CHANNEL)
    if dimensions == PER_CHANNEL and column.ndim < 2:
        column = np.broadcast_to(column if column.ndim == 0 else column[:, None], (count, channels)).copy()
    sizes = {"sample": count, "channel": channels, "xyz": 3}
    expected = tuple(sizes.get(dimension) for dimension in dimensions)
    fits = column.ndim == len(expected) and all(
        e is None or e == got for e, got in zip(expected, column.shape, strict=True)
    )
    if not fits:
        raise BadInput(f"has shape {column.shape}, which is not ({', '.join(dimensions)})", where=name)
    if name.startswith("u_") and np.any(column < 0.0):
        raise BadInput("an uncertainty is negative", where=name)
    return column


def read(path: str | Path, **options: Any) -> xr.Dataset:
    """Read samples of any known format, told by the file's content.

    Parameters
    ----------
    path : str or Path
        A file in any format that `analysis.formats` reads (docs/formats.md), told by its content; or a
        session's folder, whose `samples.nc` is read.
    **options
        What the format offers: for RT-300S `blank` (path of the blank's file) and `floor_shift` (bool).

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    BadInput
        If the file is missing, of no known format, damaged, or an option means nothing to its format.
    """
    from analysis import formats

    return formats.read(Path(path), options)


def write(samples: xr.Dataset, path: str | Path) -> Loss:
    """Write samples: NetCDF to `.nc`, CSV (without the correlated columns) to `.csv`, others by their suffix.

    Returns
    -------
    Loss
        What the file loses of the samples: by interpolation onto its grid, and what it does not hold.

    Raises
    ------
    BadInput
        If the name ends otherwise.
    """
    from analysis import formats

    return formats.write(samples, Path(path))


def select(
    samples: xr.Dataset,
    *,
    wavelength_nm: Sequence[float] | None = None,
    channels: Sequence[str] | None = None,
    max_theta_deg: float | None = None,
    where: str = "samples",
) -> xr.Dataset:
    """Narrow samples to channels and to angles of incidence and view.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples.
    wavelength_nm : sequence of float, optional
        Wavelengths to keep, each one of those in the file (to 0.01 nm).
    channels : sequence of str, optional
        Names of the channels to keep, in place of wavelengths.
    max_theta_deg : float, optional
        Largest polar angle of light and of camera to keep.
    where : str
        Name used in an error.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    BadInput
        If a wavelength or channel is not there, listing those that are, or if nothing remains.
    """
    from analysis.rejection_transfer import narrowed

    if channels is not None and wavelength_nm is not None:
        raise BadInput("chosen by wavelength and by name", where="channels", todo="give one of both")
    chosen = (
        channel_numbers(samples, wavelength_nm, where=where)
        if channels is None
        else _named_channels(samples, channels, where)
    )
    keep = np.ones(samples.sizes["sample"], dtype=bool)
    if max_theta_deg is not None:
        lowest = np.cos(np.radians(max_theta_deg)) - 1e-12
        keep = np.minimum(samples["wi"].to_numpy()[:, 2], samples["wo"].to_numpy()[:, 2]) >= lowest
        if not keep.any():
            raise BadInput(
                f"no sample has both angles within {max_theta_deg:g} deg",
                where=where,
                todo="allow larger angles, 90 at most",
            )
    if keep.all() and chosen == list(range(samples.sizes["channel"])):
        return samples
    return narrowed(samples, np.flatnonzero(keep).tolist(), chosen)


def _named_channels(samples: xr.Dataset, wanted: Sequence[str], where: str) -> list[int]:
    known = [str(name) for name in samples["channel"].to_numpy()]
    missing = next((name for name in wanted if name not in known), None)
    if missing is not None:
        raise BadInput(f"holds no channel {missing}", where=where, todo=f"choose from {', '.join(known)}")
    return [known.index(name) for name in wanted]


def channel_numbers(
    samples: xr.Dataset, wavelength_nm: Sequence[float] | None, *, where: str = "samples"
) -> list[int]:
    """Return the indices of the channels of some wavelengths, all for None; raises as `select`."""
    if wavelength_nm is None:
        return list(range(samples.sizes["channel"]))
    return _wavelength_indices(samples, wavelength_nm, where)


def _wavelength_indices(samples: xr.Dataset, wanted: Sequence[float], where: str) -> list[int]:
    if "wavelength_nm" not in samples.coords:
        names = ", ".join(str(name) for name in samples["channel"].to_numpy())
        raise BadInput(
            f"names no wavelengths, its channels are {names}", where=where, todo="leave the wavelength out"
        )
    known = samples["wavelength_nm"].to_numpy()
    indices = []
    for wavelength in wanted:
        near = int(np.argmin(np.abs(known - wavelength)))
        if not abs(known[near] - wavelength) <= 0.01:  # NaN is near nothing
            available = ", ".join(f"{w:g}" for w in known)
            raise BadInput(f"holds no {wavelength:g} nm", where=where, todo=f"choose from {available}")
        indices.append(near)
    return indices
