"""From samples to another format's file, with the loss that reading the file again shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from analysis import formats
from analysis.formats import pab
from analysis.formats.loss import Loss, place_of
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput, Refused
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from types import ModuleType

    import xarray as xr
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SAME_DIRECTION = 1e-5
"""Distance of directions that are one: formats print 6 digits and more."""


@dataclass(frozen=True)
class Conversion:
    """What was written.

    Attributes
    ----------
    files : tuple of Path
        Several where a format holds one incidence each.
    format : str
        Its name.
    samples : int
        How many samples reading them again gives.
    loss : Loss
        Of the samples by the format; where it holds samples as they are, found by reading them again.
    """

    files: tuple[Path, ...]
    format: str
    samples: int
    loss: Loss


def convert(samples: xr.Dataset, out: Path, *, to: str = "", fill: bool = False) -> Conversion:
    """Write samples in another format, read them again, and compare.

    Parameters
    ----------
    samples : xarray.Dataset
        What to write.
    out : Path
        Where to; a folder (made if it is not there) for the files of several incidences.
    to : str
        A format's name; by default the end of `out` tells.
    fill : bool
        Allow values where no sample is near, which the format's grid asks for.

    Returns
    -------
    Conversion

    Raises
    ------
    BadInput
        If no format is written so, or it cannot hold such samples.
    Refused
        If the format's grid reaches beyond the samples and `fill` does not allow that; nothing is written.
    """
    module = formats.require_writer(out, to)
    if module is pab and (out.is_dir() or not out.suffix):
        paths, loss = pab.write_folder(samples, out)
        back = [formats.read(path, {}) for path in paths]
        return Conversion(
            tuple(paths), module.NAME, sum(b.sizes["sample"] for b in back), _seen(samples, back, loss)
        )
    with whole_file(out) as file:
        loss = module.write(samples, file)
        if loss.filled and not fill:
            raise Refused(
                f"{100.0 * loss.filled_part:.2g} % of the grid of {module.NAME} lies where no sample is near",
                where=str(out),
                todo="gonio convert --fill writes guesses there; or measure more, or write samples",
            )
        back = [_read_again(module, file, out)]
    return Conversion((out,), module.NAME, back[0].sizes["sample"], _seen(samples, back, loss))


def _read_again(module: ModuleType, file: Path, out: Path) -> xr.Dataset:
    """Read by the format's own reader, through the same door as everybody's files."""
    back = formats.read(file, {})
    if formats.recognise(file) is not module:
        raise BadInput(f"would be read as another format than {module.NAME}", where=str(out), todo="tell us")
    return back


def _seen(samples: xr.Dataset, back: Sequence[xr.Dataset], loss: Loss) -> Loss:
    """Replace a loss of nothing by what the file really shows, where samples can be found again."""
    if loss.cells or any(b.sizes["channel"] != samples.sizes["channel"] for b in back):
        return loss
    wi, wo, f_r = (np.concatenate([b[name].to_numpy() for b in back]) for name in ("wi", "wo", "f_r"))
    names = [str(name) for name in back[0]["channel"].to_numpy()]
    ours = [str(name) for name in samples["channel"].to_numpy()]
    if len(names) > 1 and names != ours and "wavelength_nm" not in samples.coords:
        return replace(loss, dropped=(*loss.dropped, f"channels {', '.join(ours)} became {', '.join(names)}"))
    rows = _rows(samples)
    found, other = _found_again(samples["wi"].to_numpy()[rows], samples["wo"].to_numpy()[rows], wi, wo)
    if not found.all():
        lost = int(np.count_nonzero(~found))
        loss = replace(loss, dropped=(*loss.dropped, f"{lost} directions are not found again to 1e-5"))
    rows = rows[found]
    if not rows.size:
        return loss
    before, after = samples["f_r"].to_numpy()[rows], f_r[other]
    error = np.abs(after - before) / np.maximum(np.abs(before), np.finfo(float).tiny)
    error[after == before] = 0.0
    row, channel = np.unravel_index(np.argmax(error), error.shape)
    worst = float(error[row, channel])
    place = place_of(samples["wi"].to_numpy()[rows[row]], samples["wo"].to_numpy()[rows[row]])
    return replace(
        loss,
        median_relative=float(np.median(error)),
        p95_relative=float(np.percentile(error, 95.0)),
        worst_relative=worst,
        where_worst=f"{place}, channel {ours[int(channel)]}" if worst else "",
    )


def _rows(samples: xr.Dataset) -> NDArray[np.intp]:
    """Rows that every format would write: with values and without flags."""
    good = np.isfinite(samples["f_r"].to_numpy()).all(axis=1)
    if "flags" in samples:
        good &= (samples["flags"].to_numpy() == 0).all(axis=1)
    return np.flatnonzero(good)


def _found_again(
    wi: Array, wo: Array, wi_back: Array, wo_back: Array
) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Which pairs of directions are there again, and where: as they are, or turned to the light's azimuth."""
    from scipy.spatial import KDTree

    for view in (_as_it_is, _from_the_light):
        distance, place = KDTree(view(wi_back, wo_back)).query(view(wi, wo))
        found = distance < SAME_DIRECTION
        if found.all():
            break
    return found, place[found]


def _as_it_is(wi: Array, wo: Array) -> Array:
    return np.concatenate([wi, wo], axis=1)


def _from_the_light(wi: Array, wo: Array) -> Array:
    theta_i, phi_i = direction_to_spherical(wi)
    theta_o, phi_o = direction_to_spherical(wo)
    return np.concatenate(
        [spherical_to_direction(theta_i, 0.0 * phi_i), spherical_to_direction(theta_o, phi_o - phi_i)], axis=1
    )
