"""What all reflectance models share: parameters that describe themselves, f = kd/pi + ks * lobe."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from analysis.models.geometry import Array, Geometry
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

__all__ = [
    "KD",
    "KS",
    "Array",
    "Coordinate",
    "Geometry",
    "Kind",
    "Lobe",
    "Model",
    "OwnDiffuse",
    "Parameter",
    "product",
]


class Kind(StrEnum):
    """What a parameter does to f: scales enter linearly and can be solved for, shapes must be searched."""

    DIFFUSE_SCALE = "diffuse-scale"
    SPECULAR_SCALE = "specular-scale"
    SHAPE = "shape"


class Coordinate(StrEnum):
    """In which coordinate a fit searches a shape parameter, so that equal steps matter about equally."""

    LINEAR = "linear"
    LOG = "log"
    LOG_ABOVE_ONE = "log-above-one"

    def forward(self, value: float) -> float:
        """Coordinate of a parameter's value."""
        match self:
            case Coordinate.LOG:
                return float(np.log(value))
            case Coordinate.LOG_ABOVE_ONE:
                return float(np.log(value - 1.0))
            case _:
                return float(value)

    def inverse(self, coordinate: float) -> float:
        """Parameter's value at a coordinate."""
        match self:
            case Coordinate.LOG:
                return float(np.exp(coordinate))
            case Coordinate.LOG_ABOVE_ONE:
                return float(1.0 + np.exp(coordinate))
            case _:
                return float(coordinate)

    def slope(self, value: float) -> float:
        """Return the derivative of the parameter by its coordinate, at a parameter's value."""
        match self:
            case Coordinate.LOG:
                return value
            case Coordinate.LOG_ABOVE_ONE:
                return value - 1.0
            case _:
                return 1.0


@dataclass(frozen=True)
class Parameter:
    """One parameter of a model.

    Parameters
    ----------
    name : str
        Name of the model's field.
    kind : Kind
        Linear scale or shape.
    bounds : tuple of float
        Lowest and highest value that a fit considers. The model itself accepts anything from `minimum` up.
    minimum : float
        Lowest value with a meaning; below it the model refuses.
    default : float
        A value that looks like something.
    unit : str
        Unit, "1" for a pure number.
    coordinate : Coordinate
        Where a fit searches it.
    scan : tuple of float
        Values from which a fit starts, spread so that every basin holds one.
    maximum : float
        Highest value with a meaning; above it the model refuses.
    of_slope : callable, optional
        Of a width: its value where the facets' mean absolute slope along a line is the argument.
    """

    name: str
    kind: Kind
    bounds: tuple[float, float]
    minimum: float
    default: float
    unit: str = "1"
    coordinate: Coordinate = Coordinate.LINEAR
    scan: tuple[float, ...] = ()
    maximum: float = np.inf
    of_slope: Callable[[float], float] | None = None


KD = Parameter("kd", Kind.DIFFUSE_SCALE, (0.0, np.inf), 0.0, 0.5)
KS = Parameter("ks", Kind.SPECULAR_SCALE, (0.0, np.inf), 0.0, 0.5)


class Lobe(NamedTuple):
    """A term of f or a factor of one, and its derivatives by shape parameter, each (..., channels).

    The terms that a model hands out are in 1/sr at unit scale.
    """

    value: Array
    slopes: dict[str, Array]


def product(*factors: Lobe) -> Lobe:
    """Multiply factors; the derivatives by the product rule, without a division."""
    value, slopes = factors[0]
    for factor in factors[1:]:
        merged = {name: slope * factor.value for name, slope in slopes.items()}
        for name, slope in factor.slopes.items():
            own = value * slope
            merged[name] = merged[name] + own if name in merged else own
        value, slopes = value * factor.value, merged
    return Lobe(value, slopes)


@dataclass(frozen=True, eq=False)
class Model(ABC):
    """A reflectance model f_r = kd/pi + ks * lobe, in 1/sr, without a cosine.

    Subclasses are frozen dataclasses whose fields are the parameters, each a float or an array of shape
    (channels,); several arrays must agree. f is 0 where light or camera is not above the horizon, and NaN
    where a direction is.

    Underflow and overflow are the right values of faint and of capped terms, and raise no error.

    Attributes
    ----------
    NAME : str
        Key in `analysis.models.MODELS`.
    PARAMETERS : tuple of Parameter
        In the order of the fields.
    RECIPROCAL : bool
        Whether light and camera may change places.
    ISOTROPIC : bool
        Whether the sample may be turned about its normal.
    CONSERVES : bool
        Whether each term's directional albedo stays below its scale for every direction and every parameter
        within the bounds: whether kd + ks <= 1 is enough for no light to be created.
    LAMBERT_TERM : bool
        Whether the diffuse term is Lambert's, the same for all shapes. Where it is not, `terms_at` tells
        more than `lobe_at` can.

    Raises
    ------
    BadInput
        If a parameter is beyond the values with a meaning, or the shapes do not agree.
    """

    NAME: ClassVar[str]
    PARAMETERS: ClassVar[tuple[Parameter, ...]]
    RECIPROCAL: ClassVar[bool] = True
    ISOTROPIC: ClassVar[bool] = True
    CONSERVES: ClassVar[bool] = False
    LAMBERT_TERM: ClassVar[bool] = True

    def __post_init__(self) -> None:
        shapes = set()
        for parameter in self.PARAMETERS:
            value = np.asarray(getattr(self, parameter.name), dtype=np.float64)
            if value.ndim > 1:
                raise BadInput(
                    f"a parameter is a number or (channels,), not shape {value.shape}",
                    where=f"{self.NAME} {parameter.name}",
                )
            if np.any(value < parameter.minimum):
                raise BadInput(
                    f"is {float(np.min(value)):g}, below {parameter.minimum:g}",
                    where=f"{self.NAME} {parameter.name}",
                )
            if np.any(value > parameter.maximum):
                raise BadInput(
                    f"is {float(np.max(value)):g}, above {parameter.maximum:g}",
                    where=f"{self.NAME} {parameter.name}",
                )
            if value.size != 1:
                shapes.add(value.size)
            object.__setattr__(self, parameter.name, value)
        if len(shapes) > 1:
            raise BadInput(
                f"parameters have different numbers of channels: {sorted(shapes)}", where=self.NAME
            )

    @property
    def channels(self) -> int:
        """Number of channels of the result."""
        return max(int(np.size(getattr(self, field.name))) for field in fields(self))

    @classmethod
    def likely(cls, shapes: dict[str, Array]) -> dict[str, Array]:
        """Move shapes that are spread evenly within their bounds to where a fit had better begin.

        Most models leave them. Where shapes have a meaning only together, evenly spread ones are mostly
        surfaces that do not exist.

        Parameters
        ----------
        shapes : dict of str to ndarray, shape (M,)
            By name.

        Returns
        -------
        dict of str to ndarray, shape (M,)
        """
        return shapes

    @abstractmethod
    def lobe_at(self, geometry: Geometry) -> Lobe | None:
        """Specular lobe at unit scale with its derivatives by shape, or None for a model without one."""

    def terms_at(self, geometry: Geometry) -> dict[str, Lobe]:
        """Return the term of each linear scale at unit scale, with its derivatives by shape.

        f_r is the sum of scale times term; not yet `finish`ed.
        """
        terms = {"kd": Lobe(np.full((*geometry.visible.shape, 1), 1.0 / np.pi), {})}
        lobe = self.lobe_at(geometry)
        if lobe is not None:
            terms["ks"] = lobe
        return terms

    @np.errstate(under="ignore", over="ignore")
    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """Evaluate the model.

        Parameters
        ----------
        wi, wo : array_like, shape (..., 3)
            Unit directions to the light and to the camera, in the sample frame; leading dimensions broadcast.

        Returns
        -------
        ndarray, shape (..., channels)
            f_r in 1/sr.
        """
        geometry = Geometry(wi, wo)
        basis = self.basis_at(geometry)
        total = sum(getattr(self, name) * column for name, column in basis.items())
        # Zeros of the full shape bring parameters that differ by channel and those that do not together.
        return geometry.finish(total + np.zeros((*geometry.visible.shape, self.channels)))

    @np.errstate(under="ignore", over="ignore")
    def basis(self, wi: ArrayLike, wo: ArrayLike) -> dict[str, Array]:
        """Return df/dscale of each linear scale, by name; arguments as in `evaluate`.

        Returns
        -------
        dict of str to ndarray, shape (..., 1 or channels)
            In 1/sr; f_r is the sum of scale times column.
        """
        geometry = Geometry(wi, wo)
        return {name: geometry.finish(column) for name, column in self.basis_at(geometry).items()}

    def basis_at(self, geometry: Geometry) -> dict[str, Array]:
        """`basis` for a prepared geometry; not yet `finish`ed."""
        return {name: term.value for name, term in self.terms_at(geometry).items()}

    @np.errstate(under="ignore", over="ignore")
    def derivatives(self, wi: ArrayLike, wo: ArrayLike) -> dict[str, Array]:
        """Return the analytic derivative of f_r by each parameter; arguments as in `evaluate`.

        Returns
        -------
        dict of str to ndarray, shape (..., channels)
            Keyed by parameter, in 1/sr per unit of the parameter (of that channel).
        """
        geometry = Geometry(wi, wo)
        full = np.zeros((*geometry.visible.shape, self.channels))
        slopes: dict[str, Array] = {}
        for scale, term in self.terms_at(geometry).items():
            slopes[scale] = full + term.value
            for name, slope in term.slopes.items():
                slopes[name] = slopes.get(name, full) + vars(self)[scale] * slope
        return {name: geometry.finish(slope) for name, slope in slopes.items()}


class OwnDiffuse(Model):
    """A model whose diffuse term is not Lambert's: it has `terms_at`, and no lobe over Lambert's term."""

    LAMBERT_TERM: ClassVar[bool] = False

    def lobe_at(self, geometry: Geometry) -> Lobe | None:  # noqa: ARG002 - the interface of all models
        """Refuse, so that nobody takes the diffuse term for Lambert's.

        Raises
        ------
        BadInput
            Always.
        """
        raise BadInput(
            "has a diffuse term of its own",
            where=self.NAME,
            todo="use terms_at",
        )

    @abstractmethod
    def terms_at(self, geometry: Geometry) -> dict[str, Lobe]:
        """Return the term of each linear scale at unit scale; see `Model.terms_at`."""
