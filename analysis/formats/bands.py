"""Tables with a row for each direction and wavelength, brought to one sample a direction with a band each."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SMALLEST_NM, LARGEST_NM = 1.0, 1e6


class Bands(NamedTuple):
    """What tells samples apart (N, keys), their values (N, bands), and the ascending wavelengths (bands,)."""

    keys: Array
    values: Array
    wavelength_nm: Array


def gathered(rows: Array, nm: Array, value: Array, found: tuple[Indices, Path]) -> Bands:
    """Gather the rows of one direction, which differ in wavelength, into one sample.

    Parameters
    ----------
    rows : ndarray, shape (rows, keys)
        What tells directions apart, as it is written.
    nm, value : ndarray, shape (rows,)
        Wavelength and value of each row.
    found : tuple of ndarray of int, shape (rows,), and Path
        The line of each row and the file, for errors.

    Returns
    -------
    Bands
        In the order in which the directions appear first.

    Raises
    ------
    BadInput
        If a wavelength is none, a direction has one twice, or not all; names line.
    """
    places, path = found
    wrong = np.flatnonzero(~((nm >= SMALLEST_NM) & (nm <= LARGEST_NM)))
    if wrong.size:
        raise BadInput(
            f"{nm[wrong[0]]:g} nm is no wavelength of light",
            where=f"{path}: line {places[wrong[0]]}, column wavelength",
            todo="write nanometres",
        )
    directions, first, sample = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    wavelengths, band = np.unique(nm, return_inverse=True)
    cell = sample.ravel() * len(wavelengths) + band.ravel()
    order = np.argsort(cell, kind="stable")
    again = order[1:][np.diff(cell[order]) == 0]
    if again.size:
        raise BadInput(
            f"gives a direction a second time at {nm[again.min()]:g} nm",
            where=f"{path}: line {places[again.min()]}",
            todo="leave one of the rows",
        )
    if len(cell) != len(directions) * len(wavelengths):
        counts = np.bincount(sample.ravel(), minlength=len(directions))
        lacking = first[counts < len(wavelengths)].min()
        raise BadInput(
            f"its direction has {counts[sample.ravel()[lacking]]} of {len(wavelengths)} wavelengths",
            where=f"{path}: line {places[lacking]}",
            todo="measure all, or leave the direction out; the file may be cut short",
        )
    values = value[order].reshape(len(directions), len(wavelengths))
    appearance = np.argsort(first)
    return Bands(directions[appearance], values[appearance], wavelengths)
