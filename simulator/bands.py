"""What lamp and camera make of materials that depend on wavelength: effective f_r by channel, band by band.

A channel sees f_r weighted with the lamp's spectrum times the camera's sensitivity, both linear between
their tables' nodes:

    f_c = integral(S s_c f) / integral(S s_c)

Scales of a model enter f_r linearly: their weighted means are exact, and there is one band as for any
material. Where its shapes change, f_r is computed at some wavelengths and taken as linear in between; each
band's weights are integrated exactly. Bands are halved where that errs most until the error is below the
tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.spectra import Spectrum, read_spectrum
from rig.angles import spherical_to_direction
from rig.errors import BadInput
from simulator.line_words import CHANNELS
from simulator.mounting import PLAIN, Mounting

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rig.description import Rig
    from simulator.line_words import Value

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

STEP_NM = 1.0
"""Of the wavelengths at which lamp times camera is tabulated."""
MOST_BANDS = 128
CAUTION = 2.0
"""Times the estimated error: f_r between nodes is not a parabola, nor are all directions looked at."""
_OUTSIDE = 1e-3
"""Part of a channel's weight that may lie where a material's table ends."""
_NOT_GIVEN = "it depends on wavelength, and lamp and camera have no spectrum"


@dataclass(frozen=True, eq=False)
class Instrument:
    """Lamp and camera.

    Attributes
    ----------
    wavelength_nm : ndarray, shape (K,)
    weight : ndarray, shape (K, 3)
        By channel; each sums to 1.
    """

    wavelength_nm: Array
    weight: Array

    def mean(self, values: Array) -> Array:
        """Weighted means (3,) of values (K,)."""
        return np.asarray(self.weight.T @ values)

    def hats(self, nodes_nm: Array) -> Array:
        """Weights (N, 3) of values at nodes, linear in between and constant beyond."""
        hats = [np.interp(self.wavelength_nm, nodes_nm, unit) for unit in np.eye(len(nodes_nm))]
        return np.asarray(np.stack(hats) @ self.weight)

    def check(self, spectrum: Spectrum) -> None:
        """Refuse a material's table that ends where a channel still sees.

        Raises
        ------
        BadInput
        """
        nodes = spectrum.wavelength_nm
        outside = (self.wavelength_nm < nodes[0]) | (self.wavelength_nm > nodes[-1])
        if self.weight[outside].sum(axis=0).max(initial=0.0) > _OUTSIDE:
            what = f"it goes from {nodes[0]:g} to {nodes[-1]:g} nm, and the instrument sees beyond"
            raise BadInput(what, where=spectrum.where, todo="extend the table")


@dataclass(frozen=True)
class SpectralMaterial:
    """A model some of whose parameters depend on wavelength: not yet seen through an instrument.

    Parameters
    ----------
    spec : str
        The line that names it.
    model : str
    parameters : mapping of str to number, three, or Spectrum
    mounting : Mounting
    """

    spec: str
    model: str
    parameters: Mapping[str, Value | Spectrum] = field(hash=False)
    mounting: Mounting = PLAIN

    has_closed_form = False
    rendered = False
    truth: Mapping[str, list[float]] = field(default_factory=dict, hash=False)

    @property
    def isotropic(self) -> bool:
        """Whether the sample may be turned about its normal."""
        from analysis.models import MODELS

        return MODELS[self.model].ISOTROPIC

    def at(self, wavelength_nm: float) -> dict[str, Value]:
        """Parameters at a wavelength."""
        place = np.array([wavelength_nm])
        return {
            name: float(value.at(place)[0, 0]) if isinstance(value, Spectrum) else value
            for name, value in self.parameters.items()
        }

    def reflectance(self) -> Reflectance:
        """Refuse: which wavelengths count is not known."""
        raise _not_given(self.spec)

    def plugin(self) -> dict[str, Any]:
        """Refuse, as `reflectance` does."""
        raise _not_given(self.spec)


@dataclass(frozen=True)
class BandedMaterial:
    """A material as the camera's channels see it, a sum over bands.

    Parameters
    ----------
    spec : str
        The line that names it.
    evaluate : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in float64.
    bands : int
        At how many wavelengths it is computed.
    error : float
        Of the effective f_r by the number of bands, relative to its mean.
    isotropic : bool
    mounting : Mounting
    """

    spec: str
    evaluate: Reflectance = field(hash=False)
    bands: int
    error: float
    isotropic: bool
    mounting: Mounting = PLAIN

    has_closed_form = True
    rendered = False
    truth: Mapping[str, list[float]] = field(default_factory=dict, hash=False)

    def reflectance(self) -> Reflectance:
        """Return a function (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in float64."""
        return self.evaluate

    def plugin(self) -> dict[str, Any]:
        """Refuse: Mitsuba has no such sum.

        Raises
        ------
        BadInput
        """
        raise BadInput(
            "Mitsuba does not render bands", where=self.spec, todo="take black surroundings and no mirrors"
        )


def instrument_of(rig: Rig) -> Instrument | None:
    """Return what lamp and camera of a rig file make of wavelengths; None where neither has a spectrum.

    Where only one has, the other counts as even.

    Raises
    ------
    BadInput
        A table that cannot be used, or a channel that sees nothing of the lamp.
    """
    lamp = read_spectrum(rig.lamp.spectrum) if rig.lamp.spectrum else None
    camera = read_spectrum(rig.camera.sensitivity) if rig.camera.sensitivity else None
    given = [spectrum for spectrum in (lamp, camera) if spectrum is not None]
    if not given:
        return None
    first, last = (
        max(s.wavelength_nm[0] for s in given),
        min(s.wavelength_nm[-1] for s in given),
    )
    grid = np.arange(first, last + 0.5 * STEP_NM, STEP_NM)
    weight = np.ones((len(grid), CHANNELS))
    if lamp is not None:
        weight *= lamp.at(grid)[:, :1]
    if camera is not None:
        if camera.values.shape[1] not in {1, CHANNELS}:
            what = f"{camera.values.shape[1]} channels"
            raise BadInput(what, where=camera.where, todo="give one, or red, green and blue")
        weight *= camera.at(grid)
    total = weight.sum(axis=0)
    if len(grid) < 2 or not (total > 0.0).all() or (weight < 0.0).any():
        what = "a channel sees nothing of the lamp, or less than nothing"
        raise BadInput(what, where=given[-1].where, todo="give spectra that overlap, not negative")
    return Instrument(grid, weight / total)


def seen_through(rig: Rig, material: Any, tolerance: float) -> Any:
    """Return a material as the camera's channels see it; one that knows no wavelengths is returned as it is.

    Parameters
    ----------
    rig : Rig
        Of the lamp and the camera.
    material : Material
    tolerance : float
        Relative error of f_r that bands may make.

    Raises
    ------
    BadInput
        It needs an instrument, and there is none, or its tables end too early.
    """
    spectral = isinstance(material, SpectralMaterial)
    nodes = None if spectral else getattr(getattr(material, "data", None), "wavelength_nm", None)
    if not spectral and nodes is None:
        return material
    instrument = instrument_of(rig)
    if instrument is None:
        raise _not_given(material.spec)
    if nodes is not None:
        return _table_seen(instrument, material, nodes)
    for value in material.parameters.values():
        if isinstance(value, Spectrum):
            instrument.check(value)
    return _model_seen(instrument, material, tolerance)


def _model_seen(instrument: Instrument, material: SpectralMaterial, tolerance: float) -> Any:
    from analysis.models import MODELS
    from analysis.models.base import Kind
    from simulator.materials import ClosedFormMaterial, closed_form_material

    shapes = {p.name for p in MODELS[material.model].PARAMETERS if p.kind is Kind.SHAPE}
    spectra = {name: value for name, value in material.parameters.items() if isinstance(value, Spectrum)}
    if not shapes & spectra.keys():
        means = {
            name: tuple(instrument.mean(value.at(instrument.wavelength_nm)[:, 0]).tolist())
            for name, value in spectra.items()
        }
        plain = {n: v for n, v in material.parameters.items() if not isinstance(v, Spectrum)}
        checked = closed_form_material(material.model, {**plain, **means}, material.spec)
        return ClosedFormMaterial(material.spec, material.model, checked.parameters, material.mounting)

    def at(wavelength_nm: float) -> Reflectance:
        return closed_form_material(material.model, material.at(wavelength_nm), material.spec).reflectance()

    nodes, error = _bands(instrument, at, tolerance)
    weights, parts = instrument.hats(nodes), [at(node) for node in nodes]

    def evaluate(wi: Array, wo: Array) -> Array:
        return np.asarray(sum(weight * part(wi, wo) for weight, part in zip(weights, parts, strict=True)))

    return BandedMaterial(material.spec, evaluate, len(nodes), error, material.isotropic, material.mounting)


def _table_seen(instrument: Instrument, material: Any, nodes: Array) -> BandedMaterial:
    """Weigh a table over wavelength, linear between its nodes."""
    instrument.check(Spectrum(nodes, nodes[:, None], material.path))
    weights, data = instrument.hats(nodes), material.data

    def evaluate(wi: Array, wo: Array) -> Array:
        return np.asarray(data.f_r(wi, wo) @ weights)

    return BandedMaterial(material.spec, evaluate, len(nodes), 0.0, material.isotropic, material.mounting)


def _bands(
    instrument: Instrument, at: Callable[[float], Reflectance], tolerance: float
) -> tuple[Array, float]:
    """Choose wavelengths between which f_r is linear enough; return them and the error that is left."""
    wi, wo = _probes()
    seen = instrument.weight.max(axis=1) > 0.0
    ends = instrument.wavelength_nm[seen][[0, -1]]
    known = {float(node): at(float(node))(wi, wo) for node in ends}
    off: dict[tuple[float, float], Array] = {}
    while True:
        nodes = sorted(known)
        for low, high in pairwise(nodes):
            if (low, high) not in off:
                middle = at(0.5 * (low + high))(wi, wo)
                inside = (instrument.wavelength_nm >= low) & (instrument.wavelength_nm < high)
                # A parabola's mean is two thirds of its middle.
                part = 2.0 / 3.0 * instrument.weight[inside].sum(axis=0)
                off[low, high] = part * (middle - 0.5 * (known[low] + known[high]))
        values = np.stack([known[node] for node in nodes])
        mean = np.mean(np.einsum("nc,npc->pc", instrument.hats(np.array(nodes)), values))
        parts = {pair: off[pair] for pair in pairwise(nodes)}
        error = CAUTION * _rms(np.sum(list(parts.values()), axis=0)) / mean if mean > 0.0 else 0.0
        worst = max(parts, key=lambda pair: _rms(parts[pair]))
        if error <= tolerance or len(nodes) >= MOST_BANDS or worst[1] - worst[0] <= STEP_NM:
            return np.array(nodes), float(error)
        middle_nm = 0.5 * (worst[0] + worst[1])
        known[middle_nm] = at(middle_nm)(wi, wo)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _probes() -> tuple[Array, Array]:
    """Pairs of directions (N, 3): every angle with every other, across and around the mirror direction."""
    theta = np.radians([2.0, 15.0, 30.0, 45.0, 60.0, 75.0])
    grid = np.stack(np.meshgrid(theta, theta, np.radians([0.0, 90.0, 180.0])), axis=-1).reshape(-1, 3)
    return (
        spherical_to_direction(grid[:, 0], np.zeros(len(grid))),
        spherical_to_direction(grid[:, 1], grid[:, 2]),
    )


def _not_given(spec: str) -> BadInput:
    return BadInput(_NOT_GIVEN, where=spec, todo="give lamp.spectrum and camera.sensitivity in the rig file")
