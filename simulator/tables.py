"""Measured files as materials: their f_r in float64, and where Mitsuba can read them, its own plugin.

Both evaluate a file alike, as renderers do: the table's first direction, which its laboratory lit from, is
the camera's here. They would agree the other way round, too, if the table were reciprocal; measured ones are
so within some per cent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from analysis.formats import merl
from analysis.formats.rgl_table import Table
from analysis.formats.tensor import read_tensors
from rig.errors import BadInput
from simulator.line_words import CHANNELS
from simulator.mounting import PLAIN, Mounting

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

RGL, MERL = "bsdf", "merl"
TABLES = (RGL, MERL)
"""Kinds of files, as a station's line names them."""
_NEEDS_BANDS = "it has wavelengths, and lamp and camera have no spectrum"
_GIVE_BANDS = "give lamp.spectrum and camera.sensitivity in the rig file"


class TableData(Protocol):
    """What a file holds."""

    @property
    def wavelength_nm(self) -> Array | None:
        """Of its channels; None for linear RGB."""

    @property
    def isotropic(self) -> bool:
        """Whether the sample may be turned about its normal."""

    def f_r(self, wi: Array, wo: Array) -> Array:
        """Evaluate pairs of directions (N, 3): (N, channels) in 1/sr."""


@dataclass(frozen=True)
class TableMaterial:
    """A material that a measured file describes.

    Parameters
    ----------
    spec : str
        The line that names it.
    kind : str
        Of `TABLES`.
    path : str
        The file.
    mounting : Mounting
        How the sample is made and mounted.
    """

    spec: str
    kind: str
    path: str
    mounting: Mounting = PLAIN

    @property
    def truth(self) -> dict[str, list[float]]:
        """Empty: it has no parameters."""
        return {}

    @property
    def data(self) -> TableData:
        """The file, read once as long as it does not change.

        Raises
        ------
        BadInput
            It is damaged.
        """
        return _read(self.kind, self.path, Path(self.path).stat().st_mtime_ns)

    @property
    def isotropic(self) -> bool:
        """Whether the sample may be turned about its normal."""
        return self.data.isotropic

    @property
    def has_closed_form(self) -> bool:
        """Whether its f_r is known in float64: not without bands where it has wavelengths."""
        return self.data.wavelength_nm is None

    @property
    def rendered(self) -> bool:
        """Whether Mitsuba can be given it: it reads no wavelengths beside RGB, and nothing of MERL's."""
        return self.kind == RGL and self.has_closed_form

    def reflectance(self) -> Callable[[Array, Array], Array]:
        """Return a function (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in float64.

        Raises
        ------
        BadInput
            The file is damaged or has wavelengths.
        """
        data = self.data
        if not self.has_closed_form:
            raise BadInput(_NEEDS_BANDS, where=self.spec, todo=_GIVE_BANDS)
        return data.f_r

    def plugin(self) -> dict[str, Any]:
        """Return the description that Mitsuba loads.

        Raises
        ------
        BadInput
            Mitsuba cannot read such a file.
        """
        if not self.rendered:
            what = "Mitsuba does not read such a file" if self.has_closed_form else _NEEDS_BANDS
            raise BadInput(what, where=self.spec, todo="take black surroundings and no mirrors")
        return {"type": "measured", "filename": str(Path(self.path).resolve())}


def read_table_material(spec: str, kind: str, path: str, mounting: Mounting = PLAIN) -> TableMaterial:
    """Return the material of a file, which is read and checked.

    Raises
    ------
    BadInput
        A file that is not there, of another kind, or damaged.
    """
    material = TableMaterial(spec, kind, path, mounting)
    try:
        with Path(path).open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        reason = error.strerror or "unreadable"
        raise BadInput(
            f"{reason}: {path}", where=spec, todo=f"give the path of a {_SUFFIX[kind]} file"
        ) from None
    if not _SNIFF[kind](head):
        raise BadInput(f"{path} is not {_NAME[kind]}", where=spec, todo=f"give a {_SUFFIX[kind]} file")
    _ = material.data
    return material


class _Rgl:
    """A tensor file, as `measured` of Mitsuba evaluates it."""

    def __init__(self, path: Path) -> None:
        self._table = Table(read_tensors(path), str(path))
        self.wavelength_nm = self._table.wavelength_nm
        self.isotropic = self._table.isotropic

    def f_r(self, wi: Array, wo: Array) -> Array:
        value = self._table.evaluate(wo, wi)
        return np.divide(value, wi[:, 2:], out=np.zeros_like(value), where=wi[:, 2:] > 0.0)


class _Merl:
    """A file of MERL's: the value of the bin, as its own reader has it; bins without one are black."""

    wavelength_nm = None
    isotropic = True

    def __init__(self, path: Path) -> None:
        self._planes = np.maximum(merl.read_table(path), 0.0)

    def f_r(self, wi: Array, wo: Array) -> Array:
        above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
        values = np.zeros((len(wi), CHANNELS))
        values[above] = merl.evaluate(self._planes, wi[above], wo[above])
        return values


_HEAD = 12
_READERS: dict[str, Callable[[Path], TableData]] = {RGL: _Rgl, MERL: _Merl}
_SNIFF: dict[str, Callable[[bytes], bool]] = {RGL: lambda head: head == b"tensor_file\0", MERL: merl.sniff}
_NAME = {RGL: "a measured BSDF", MERL: "one of MERL's tables"}
_SUFFIX = {RGL: ".bsdf", MERL: ".binary"}


@lru_cache(maxsize=8)
def _read(kind: str, path: str, _modified_ns: int) -> TableData:
    return _READERS[kind](Path(path))
