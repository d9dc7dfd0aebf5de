"""What a station can hold, written in one line.

lambert:kd=0.5                                     a model of `analysis.models`
cook-torrance:kd=0.1/0.2/0.3,ks=0.5,m=0.2,ior=1.5  slashes separate red, green and blue
lambert:kd=paint.csv                               a table over wavelength; see `analysis.spectra`
mitsuba:roughconductor,alpha=0.2,material=Au       any BSDF of Mitsuba by its name
bsdf:paint.bsdf                                    a measured BSDF file (Dupuy & Jakob 2018)
merl:gold-metallic-paint.binary                    a measured file of MERL's (Matusik et al. 2003)

What follows an `@` says how it is made and mounted; see `simulator.mounting`:

lambert:kd=0.5@sphere:radius_mm=15@checker:side_mm=4,kd=0.1
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.spectra import LIBRARY, SUFFIXES, read_spectrum
from rig.errors import BadInput
from simulator.bands import BandedMaterial, SpectralMaterial
from simulator.bsdfs import PLUGIN, has_lobes
from simulator.line_words import CHANNELS, Value, hint, numbers, pairs
from simulator.mounting import PLAIN, Mounting, mounting_of, split_parts
from simulator.tables import TABLES, TableMaterial, read_table_material

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]
    Reflectance = Callable[[Array, Array], Array]

MITSUBA_PREFIX = "mitsuba"
NOT_RENDERED = "the material has a closed form, but Mitsuba cannot hold it"
"""Why no method that goes through Mitsuba will do for a material that is not `rendered`."""


@dataclass(frozen=True)
class ClosedFormMaterial:
    """A material whose f_r is a model of `analysis.models`.

    Parameters
    ----------
    spec : str
        The line that names it.
    model : str
        Name of the model.
    parameters : mapping of str to float or tuple of float
        Value, or one per channel, of every parameter.
    mounting : Mounting
        How the sample is made and mounted.
    """

    spec: str
    model: str
    parameters: Mapping[str, Value] = field(hash=False)
    mounting: Mounting = PLAIN

    has_closed_form = True

    @property
    def truth(self) -> dict[str, list[float]]:
        """Parameters by name, each a list of three channels."""
        return {
            name: list(value) if isinstance(value, tuple) else [value] * CHANNELS
            for name, value in self.parameters.items()
        }

    def closed_form(self) -> Model:
        """Return the float64 model."""
        from analysis.models import MODELS

        return MODELS[self.model](**self.parameters)

    @property
    def isotropic(self) -> bool:
        """Whether the sample may be turned about its normal."""
        from analysis.models import MODELS

        return MODELS[self.model].ISOTROPIC

    def reflectance(self) -> Reflectance:
        """Return a function (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in float64."""
        model = self.closed_form()

        def evaluate(wi: Array, wo: Array) -> Array:
            values = model.evaluate(wi, wo)
            return np.broadcast_to(values, (*values.shape[:-1], CHANNELS))

        return evaluate

    @property
    def rendered(self) -> bool:
        """Whether Mitsuba can be given it; where not, it is evaluated in closed form alone."""
        truth = self.truth
        channels = ({name: values[i] for name, values in truth.items()} for i in range(CHANNELS))
        return has_lobes(self.model, channels)

    def plugin(self) -> dict[str, Any]:
        """Return the description that Mitsuba loads once `simulator.bsdfs` is registered.

        Raises
        ------
        BadInput
            If Mitsuba cannot render the model.
        """
        if not self.rendered:
            raise BadInput(
                NOT_RENDERED,
                where=self.spec,
                todo="take black surroundings, where the closed form is enough, or another model",
            )
        if self.model == "lambert":
            return {"type": "diffuse", "reflectance": {"type": "rgb", "value": self.truth["kd"]}}
        return {"type": PLUGIN, "model": self.model, **_flat(self.truth)}


@dataclass(frozen=True)
class MitsubaMaterial:
    """A material that only Mitsuba knows.

    Parameters
    ----------
    spec : str
        The line that names it.
    description : mapping
        The BSDF as Mitsuba loads it; colours are tuples of three.
    mounting : Mounting
        How the sample is made and mounted.
    """

    spec: str
    description: Mapping[str, Any] = field(hash=False)
    mounting: Mounting = PLAIN

    has_closed_form = False
    isotropic = False

    @property
    def truth(self) -> dict[str, list[float]]:
        """Empty: there is no closed form to recover."""
        return {}

    @property
    def rendered(self) -> bool:
        """True: Mitsuba is all that knows it."""
        return True

    def plugin(self) -> dict[str, Any]:
        """Return the description that Mitsuba loads."""
        return {
            key: {"type": "rgb", "value": list(value)} if isinstance(value, tuple) else value
            for key, value in self.description.items()
        }


Material = ClosedFormMaterial | MitsubaMaterial | TableMaterial | SpectralMaterial | BandedMaterial


def _flat(truth: Mapping[str, list[float]]) -> dict[str, float]:
    """One plain number per parameter and channel: what a plugin of our own is configured with."""
    return {
        f"{name}_{channel}": value for name, values in truth.items() for channel, value in enumerate(values)
    }


def lambert(rho: float, *, spec: str = "") -> ClosedFormMaterial:
    """Return an ideal diffuser of albedo `rho`: the white, or with 0 the light trap."""
    return ClosedFormMaterial(spec or _line("lambert", {"kd": rho}), "lambert", {"kd": rho})


def parse_material(spec: str | Material) -> Material:
    """Read one line that names a material.

    Parameters
    ----------
    spec : str or Material
        The line; a material is returned as it is.

    Returns
    -------
    Material

    Raises
    ------
    BadInput
        An unknown kind, model or parameter, a missing or impossible value, or a file that is not there.
        What is wrong inside a Mitsuba BSDF shows when it is loaded.
    """
    if not isinstance(spec, str):
        return spec
    text, parts = split_parts(spec.strip())
    kind, _, rest = text.partition(":")
    material = _parse(spec, kind.strip().lower(), rest.strip())
    if not parts:
        return material
    mounting = mounting_of(spec, parts, lambda changed: _changed(material, changed))
    if material.isotropic:
        # Turned, it is the same.
        mounting = replace(mounting, turn_rad=0.0)
    return replace(material, mounting=mounting)


def _parse(spec: str, kind: str, rest: str) -> Material:
    if kind in TABLES:
        return read_table_material(spec, kind, rest)
    if kind == MITSUBA_PREFIX:
        return _mitsuba(spec, rest)
    given = pairs(spec, rest)
    tables = {key: text for key, text in given.items() if text.endswith(SUFFIXES) or text.startswith(LIBRARY)}
    values = {key: numbers(spec, key, text) for key, text in given.items() if key not in tables}
    if not tables:
        return closed_form_material(kind, values, spec)
    spectra = {key: read_spectrum(text) for key, text in tables.items()}
    material = SpectralMaterial(spec, kind, {**values, **spectra})
    for node in np.unique(np.concatenate([spectrum.wavelength_nm for spectrum in spectra.values()])):
        # Every wavelength has to be possible.
        closed_form_material(kind, material.at(float(node)), spec)
    return material


def _changed(material: Material, changed: Mapping[str, str]) -> Material:
    """Return the material with other parameters: a pattern's second one."""
    spec = material.spec
    if isinstance(material, ClosedFormMaterial):
        values = {key: numbers(spec, key, text) for key, text in changed.items()}
        return closed_form_material(material.model, {**material.parameters, **values}, spec)
    if isinstance(material, MitsubaMaterial):
        options = {key: _option(spec, key, text) for key, text in changed.items()}
        return MitsubaMaterial(spec, {**material.description, **options})
    what = "only a material whose parameters are numbers can have a pattern"
    raise BadInput(what, where=spec, todo="leave the pattern out")


def closed_form_material(model: str, parameters: Mapping[str, Value], spec: str = "") -> ClosedFormMaterial:
    """Return the material of a model, all of its parameters given.

    Parameters
    ----------
    model : str
        Name of a model in `analysis.models`.
    parameters : mapping of str to float or tuple of float
        Value, or three, of each parameter.
    spec : str, optional
        The line that names it; by default one that `parse_material` reads back.

    Raises
    ------
    BadInput
        An unknown model or parameter, a missing one, or an impossible value.
    """
    from analysis.models import MODELS

    spec = spec or _line(model, parameters)
    if model not in MODELS:
        kinds = [*MODELS, MITSUBA_PREFIX, *TABLES]
        raise BadInput(
            f"there is no material of kind {model!r}", where=spec, todo=hint(model, kinds, "known kinds")
        )
    names = [parameter.name for parameter in MODELS[model].PARAMETERS]
    for name in parameters.keys() - set(names):
        raise BadInput(f"{model} has no parameter {name}", where=spec, todo=hint(name, names, f"{model} has"))
    for name in names:
        if name not in parameters:
            raise BadInput(f"{model} needs {name}", where=spec, todo=f"give {', '.join(names)}")
    material = ClosedFormMaterial(spec, model, {name: parameters[name] for name in names})
    try:
        material.closed_form()
    except BadInput as error:
        raise BadInput(str(error), where=spec, todo="correct the value") from None
    return material


def _line(model: str, parameters: Mapping[str, Value]) -> str:
    """Write a material's line."""
    parts = (
        f"{name}={'/'.join(map(repr, value if isinstance(value, tuple) else (value,)))}"
        for name, value in parameters.items()
    )
    return f"{model}:{','.join(parts)}"


def _mitsuba(spec: str, rest: str) -> MitsubaMaterial:
    plugin, _, options = rest.partition(",")
    if not plugin.strip():
        raise BadInput("no BSDF named", where=spec, todo="write for example mitsuba:roughconductor,alpha=0.2")
    description: dict[str, Any] = {"type": plugin.strip()}
    for key, text in pairs(spec, options).items():
        description[key] = _option(spec, key, text)
    return MitsubaMaterial(spec, description)


def _option(spec: str, key: str, text: str) -> bool | float | str | tuple[float, ...]:
    if text.lower() in {"true", "false"}:
        return text.lower() == "true"
    try:
        float(text.partition("/")[0])
    except ValueError:
        return text
    return numbers(spec, key, text)


def load_bsdf(mi: Any, material: Material) -> Any:
    """Load a material's BSDF in Mitsuba's current variant.

    Parameters
    ----------
    mi : module
        Mitsuba with its variant set, and with `simulator.bsdfs.register` done for closed forms.
    material : Material
        What to load.

    Returns
    -------
    mitsuba.BSDF

    Raises
    ------
    BadInput
        Mitsuba refuses it, or what it names is not a BSDF.
    """
    try:
        loaded = mi.load_dict(material.plugin(), optimize=False)
    except (RuntimeError, TypeError) as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise BadInput(reason, where=material.spec, todo="see Mitsuba's list of BSDF plugins") from None
    if not isinstance(loaded, mi.BSDF):
        raise BadInput("it is not a BSDF", where=material.spec, todo="see Mitsuba's list of BSDF plugins")
    return loaded


def station_materials(
    stations: Mapping[str, str],
    materials: Mapping[str, str | Material],
    white_rho: float,
    trap_rho: float = 0.0,
) -> dict[str, Material]:
    """Decide what lies at each station.

    Parameters
    ----------
    stations : mapping of str to str
        Kind ("white", "trap" or "sample") by station; empty for a machine without a wheel, whose person
        mounts what `materials` names.
    materials : mapping of str to (str or Material)
        Specification by station.
    white_rho, trap_rho : float
        True albedos of the white and of the light trap.

    Returns
    -------
    dict of str to Material
        By station; a sample's station that nothing was put on is absent: black.

    Raises
    ------
    BadInput
        A specification is wrong, or names a station that the machine does not have.
    """
    fixed = {"white": lambert(white_rho, spec="white"), "trap": lambert(trap_rho, spec="trap")}
    kinds = stations or {name: name for name in fixed}
    placed: dict[str, Material] = {name: fixed[kind] for name, kind in kinds.items() if kind in fixed}
    for name, spec in materials.items():
        if stations and name not in stations:
            raise BadInput(
                f"the machine has no station {name!r}", where="materials", todo=hint(name, stations, "it has")
            )
        placed[name] = parse_material(spec)
    return placed
