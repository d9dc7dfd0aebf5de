"""What a command does before it writes over samples that a person worked on: their rejections are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gonio.output import say
from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    import xarray as xr

TODO = "write to another name, or give --drop-rejections"


def add_drop_option(parser: argparse.ArgumentParser) -> None:
    """Declare `--drop-rejections`."""
    parser.add_argument(
        "--drop-rejections",
        action="store_true",
        help="forget the rejections of a .nc file that is written over (default: keep them, or refuse)",
    )


def require_place(out: Path, options: argparse.Namespace, *, to: str = "") -> None:
    """Return if the rejections of a file that is to be written over, if any, have a place in the new one.

    Parameters
    ----------
    out : Path
        The file to be.
    options : argparse.Namespace
        With `drop_rejections`.
    to : str
        The format's short name; without it the name's end chooses.

    Raises
    ------
    Refused
        If the new file's format has no log, or the earlier file is damaged.
    """
    if _earlier(out, options) is None:
        return
    from analysis.formats import netcdf, require_writer

    if require_writer(out, to) is not netcdf:
        raise Refused("holds rejections, for which this format has no place", where=str(out), todo=TODO)


def keep_rejections(samples: xr.Dataset, out: Path, options: argparse.Namespace) -> xr.Dataset:
    """Return samples with the rejections of the file that they are about to be written over.

    The file is read anew: a person may reject samples while a reduction runs.

    Raises
    ------
    Refused
        If a rejection cannot be carried over; nothing is written.
    """
    earlier = _earlier(out, options)
    if earlier is None:
        return samples
    from analysis.rejection_transfer import carry_over

    try:
        kept = carry_over(earlier, samples)
    except Refused as error:
        raise Refused(error.what, where=str(out), todo=TODO) from error
    say(f"the rejections in {out} are kept")
    return kept


def _earlier(out: Path, options: argparse.Namespace) -> xr.Dataset | None:
    """Return the samples of the file, if there is a log of rejections in it."""
    if options.drop_rejections or not out.is_file():
        return None
    from analysis.formats import netcdf
    from analysis.rejection import log_of

    with out.open("rb") as stream:
        if not netcdf.sniff(stream.read(len(netcdf.MAGIC))):
            return None
    try:
        samples = netcdf.read(out)
        return samples if log_of(samples) else None
    except BadInput as error:
        what = f"whether it holds rejections is not known: {error.what}"
        raise Refused(what, where=str(out), todo=TODO) from error
