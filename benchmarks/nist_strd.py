"""The fits' own search on NIST's 27 certified nonlinear regressions (Statistical Reference Datasets).

Parameters that enter linearly are solved for (variable projection: Golub & Pereyra 1973, with the Jacobian of
Kaufman 1975), the others are searched by `analysis.descent.descend`, which is the search of every fit, from
both of NIST's starts, in the plain parameters and without bounds. Derivatives are by complex step, exact to
rounding. Standard deviations come from the full Jacobian at the end. Digits are -log10 of the relative error,
at most those that NIST gives.

All is in double precision. One number cannot be had in it: the standard deviations of Lanczos1, whose
residuals of 1e-13 are differences of numbers near 1, known to 1e-16, so that three digits of their size are
left. They are shown as they are; beside them stand those of the same solution with nothing changed but the
residuals' arithmetic, in the 64 bits of x86's long double, and one Gauss-Newton step with these residuals.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.descent import descend, from_residuals
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "nist-strd"
MOST_DIGITS = 11.0
PARAMETER_DIGITS, DEVIATION_DIGITS = 6.0, 5.0
BEYOND_DOUBLE = ("Lanczos1",)
"""Problems whose standard deviations cannot be had from residuals in double precision: see the module."""
EXCHANGED = {"MGH17": [0, 2, 1, 4, 3]}
"""Order of parameters that is the same solution: a sum of two decays does not tell which is the first."""
TOLERANCE, MOST_STEPS = 1e-19, 2000
STEP = 1e-30

Columns = list[Any]


@dataclass(frozen=True)
class Separable:
    """A model: offset(x, *searched) + sum of linear parameters times columns(x, *searched).

    Attributes
    ----------
    linear, searched : tuple of int
        Numbers of the parameters b_k, counted from 1.
    columns, offset : callable
        Of x and the searched parameters, which may be complex.
    """

    linear: tuple[int, ...]
    searched: tuple[int, ...]
    columns: Callable[..., Columns]
    offset: Callable[..., Any] = lambda x, *_: 0.0 * x


def _gauss(x: Any, *searched: Any) -> Columns:
    b2, b4, b5, b7, b8 = searched
    return [np.exp(-b2 * x), np.exp(-(((x - b4) / b5) ** 2)), np.exp(-(((x - b7) / b8) ** 2))]


def _enso(x: Any, b4: Any, b7: Any) -> Columns:
    turns = [2.0 * np.pi * x / period for period in (12.0, b4, b7)]
    return [1.0 + 0.0 * x, *(wave(turn) for turn in turns for wave in (np.cos, np.sin))]


def _cubics(x: Any, b5: Any, b6: Any, b7: Any) -> Columns:
    return [x**k / (1.0 + x * (b5 + x * (b6 + x * b7))) for k in range(4)]


def _decays(x: Any, *rates: Any) -> Columns:
    return [np.exp(-rate * x) for rate in rates]


GAUSS = Separable((1, 3, 6), (2, 4, 5, 7, 8), _gauss)
CHWIRUT = Separable((), (1, 2, 3), lambda *_: [], lambda x, b1, b2, b3: np.exp(-b1 * x) / (b2 + b3 * x))
CUBICS = Separable((1, 2, 3, 4), (5, 6, 7), _cubics)
LANCZOS = Separable((1, 3, 5), (2, 4, 6), _decays)
SATURATION = Separable((1,), (2,), lambda x, b2: [-np.expm1(-b2 * x)])

MODELS: dict[str, Separable] = {
    "Bennett5": Separable((1,), (2, 3), lambda x, b2, b3: [(b2 + x) ** (-1.0 / b3)]),
    "BoxBOD": SATURATION,
    "Chwirut1": CHWIRUT,
    "Chwirut2": CHWIRUT,
    "DanWood": Separable((1,), (2,), lambda x, b2: [x**b2]),
    "ENSO": Separable((1, 2, 3, 5, 6, 8, 9), (4, 7), _enso),
    "Eckerle4": Separable((1,), (2, 3), lambda x, b2, b3: [np.exp(-0.5 * ((x - b3) / b2) ** 2) / b2]),
    "Gauss1": GAUSS,
    "Gauss2": GAUSS,
    "Gauss3": GAUSS,
    "Hahn1": CUBICS,
    "Kirby2": Separable(
        (1, 2, 3), (4, 5), lambda x, b4, b5: [x**k / (1.0 + x * (b4 + x * b5)) for k in range(3)]
    ),
    "Lanczos1": LANCZOS,
    "Lanczos2": LANCZOS,
    "Lanczos3": LANCZOS,
    "MGH09": Separable((1,), (2, 3, 4), lambda x, b2, b3, b4: [x * (x + b2) / (x * (x + b3) + b4)]),
    "MGH10": Separable((1,), (2, 3), lambda x, b2, b3: [np.exp(b2 / (x + b3))]),
    "MGH17": Separable((1, 2, 3), (4, 5), lambda x, *rates: [1.0 + 0.0 * x, *_decays(x, *rates)]),
    "Misra1a": SATURATION,
    "Misra1b": Separable((1,), (2,), lambda x, b2: [1.0 - (1.0 + 0.5 * b2 * x) ** -2]),
    "Misra1c": Separable((1,), (2,), lambda x, b2: [1.0 - (1.0 + 2.0 * b2 * x) ** -0.5]),
    "Misra1d": Separable((1,), (2,), lambda x, b2: [b2 * x / (1.0 + b2 * x)]),
    "Nelson": Separable((1, 2), (3,), lambda x, b3: [1.0 + 0.0 * x[0], -x[0] * np.exp(-b3 * x[1])],
        lambda x, _: 0.0 * x[0]),
    "Rat42": Separable((1,), (2, 3), lambda x, b2, b3: [1.0 / (1.0 + np.exp(b2 - b3 * x))]),
    "Rat43": Separable(
        (1,), (2, 3, 4), lambda x, b2, b3, b4: [(1.0 + np.exp(b2 - b3 * x)) ** (-1.0 / b4)]
    ),
    "Roszman1": Separable(
        (1, 2), (3, 4), lambda x, *_: [1.0 + 0.0 * x, -x],
        lambda x, b3, b4: -np.arctan(b3 / (x - b4)) / np.pi,
    ),
    "Thurber": CUBICS,
}  # fmt: skip


class Reference(NamedTuple):
    """A problem as NIST gives it: y (n,), x (n,) or (2, n), starts (2, P), certified values.

    exact_y and exact_x are y and x as printed, in long double.
    """

    y: NDArray[np.float64]
    x: NDArray[np.float64]
    starts: NDArray[np.float64]
    values: NDArray[np.float64]
    deviations: NDArray[np.float64]
    exact_y: NDArray[np.longdouble]
    exact_x: NDArray[np.longdouble]


class Found(NamedTuple):
    """Digits that agree, the worst of all parameters; the last with residuals in long double."""

    parameters: float
    deviations: float
    extended_deviations: float


def read_reference(path: Path) -> Reference:
    """Read one of NIST's files."""
    lines = path.read_text("ascii").splitlines()
    rows = [line.split("=")[1].split() for line in lines if re.match(r"\s*b\d+\s*=", line)]
    table = np.array([[float(entry) for entry in row] for row in rows if len(row) == 4])
    last = max(i for i, line in enumerate(lines) if line.startswith("Data:"))
    entries = [line.split() for line in lines[last + 1 :] if line.strip()]
    data = np.array([[np.longdouble(entry) for entry in row] for row in entries])
    y, x = data[:, 0], data[:, 1:].T
    y, x = (np.log(y), x) if path.stem == "Nelson" else (y, x[0])
    doubles = y.astype(np.float64), x.astype(np.float64)
    return Reference(*doubles, table[:, :2].T, table[:, 2], table[:, 3], y, x)


class Projected:
    """Residuals and Jacobian in the searched parameters, the linear ones solved for."""

    def __init__(self, model: Separable, reference: Reference) -> None:
        self.model, self.reference = model, reference

    def linear(self, searched: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Return an orthonormal basis of the columns (n, K), and the linear parameters (K,)."""
        columns = self._columns(searched).real
        length = np.linalg.norm(columns, axis=0)
        basis, triangle = np.linalg.qr(columns / length)
        target = self.reference.y - self.model.offset(self.reference.x, *searched).real
        return basis, np.linalg.solve(triangle, basis.T @ target) / length

    def residual(self, searched: NDArray[np.float64]) -> NDArray[np.float64]:
        """Model minus data, shape (n,)."""
        with np.errstate(all="ignore"):
            try:
                _, linear = self.linear(searched)
            except np.linalg.LinAlgError:
                return np.full_like(self.reference.y, np.nan)
            return np.asarray(self._model(searched, linear).real - self.reference.y)

    def jacobian(self, searched: NDArray[np.float64]) -> NDArray[np.float64]:
        """Kaufman's Jacobian, shape (n, searched)."""
        with np.errstate(all="ignore"):
            try:
                basis, linear = self.linear(searched)
            except np.linalg.LinAlgError:
                return np.full((len(self.reference.y), len(searched)), np.nan)
            slopes = self.slopes(searched, linear)
            return np.asarray(slopes - basis @ (basis.T @ slopes))

    def slopes(self, searched: NDArray[Any], linear: NDArray[np.float64]) -> NDArray[np.float64]:
        """Differentiate the model by the searched parameters alone, by complex step."""
        steps = STEP * np.eye(len(searched))
        return np.stack([self._model(searched + 1j * step, linear).imag / STEP for step in steps], axis=1)

    def deviations(self, searched: NDArray[np.float64], *, extended: bool = False) -> NDArray[np.float64]:
        """Return standard deviations of all parameters in NIST's order.

        With `extended` the residuals are in long double, after one Gauss-Newton step with them.
        """
        jacobian = self._full_jacobian(searched)
        length = np.linalg.norm(jacobian, axis=0)
        basis, triangle = np.linalg.qr(jacobian / length)
        residual = self.residual(searched)
        if extended:
            values = self.parameters(searched).astype(np.longdouble)
            first = self._extended_residual(values).astype(np.float64)
            step = np.linalg.solve(triangle, basis.T @ first) / length
            residual = self._extended_residual(values - step).astype(np.float64)
        variance = residual @ residual / (len(residual) - len(length))
        return np.asarray(np.sqrt(variance * np.sum(np.linalg.inv(triangle) ** 2, axis=1)) / length)

    def _full_jacobian(self, searched: NDArray[np.float64]) -> NDArray[np.float64]:
        """Differentiate the model by all parameters in NIST's order, shape (n, P)."""
        _, linear = self.linear(searched)
        jacobian = np.empty((len(self.reference.y), len(searched) + len(linear)))
        jacobian[:, [k - 1 for k in self.model.searched]] = self.slopes(searched, linear)
        if self.model.linear:
            jacobian[:, [k - 1 for k in self.model.linear]] = self._columns(searched).real
        return jacobian

    def _extended_residual(self, values: NDArray[np.longdouble]) -> NDArray[np.longdouble]:
        """Model minus data in long double, for all parameters in NIST's order."""
        searched = values[[k - 1 for k in self.model.searched]]
        x, y = self.reference.exact_x, self.reference.exact_y
        model = self.model.offset(x, *searched)
        for number, column in zip(self.model.linear, self.model.columns(x, *searched), strict=True):
            model = model + values[number - 1] * column
        return np.asarray(model - y)

    def parameters(self, searched: NDArray[np.float64]) -> NDArray[np.float64]:
        """All parameters in NIST's order."""
        values = np.empty(len(self.model.searched) + len(self.model.linear))
        values[[k - 1 for k in self.model.searched]] = searched
        if self.model.linear:
            values[[k - 1 for k in self.model.linear]] = self.linear(searched)[1]
        return values

    def _columns(self, searched: NDArray[Any]) -> NDArray[Any]:
        columns = self.model.columns(self.reference.x, *searched)
        return np.stack(columns, axis=1) if columns else np.zeros((len(self.reference.y), 0))

    def _model(self, searched: NDArray[Any], linear: NDArray[np.float64]) -> NDArray[Any]:
        offset = self.model.offset(self.reference.x, *searched)
        return np.asarray(offset + self._columns(searched) @ linear + 0j)


def solve(name: str, start: int) -> Found:
    """Solve a problem from one of its starts, 0 or 1."""
    model, reference = MODELS[name], read_reference(DATA / f"{name}.dat")
    projected = Projected(model, reference)
    first = reference.starts[start][[k - 1 for k in model.searched]]
    free = np.full(len(first), np.inf)
    found = descend(
        from_residuals(projected.residual, projected.jacobian), first[None], (-free, free),
        tolerance=TOLERANCE, most=MOST_STEPS,
    )  # fmt: skip
    searched = found.x[0]
    values = projected.parameters(searched)
    deviations = [projected.deviations(searched, extended=extended) for extended in (False, True)]
    order = np.arange(len(values))
    return max(
        Found(
            _digits(values[o], reference.values),
            *(_digits(deviation[o], reference.deviations) for deviation in deviations),
        )
        for o in (order, np.array(EXCHANGED.get(name, order)))
    )


def _digits(found: NDArray[np.float64], certified: NDArray[np.float64]) -> float:
    relative = np.max(np.abs(found - certified) / np.abs(certified))
    if not np.isfinite(relative):
        return 0.0
    return float(np.clip(-np.log10(max(relative, 1e-300)), 0.0, MOST_DIGITS))


def problems() -> Sequence[str]:
    """Names of all problems; BadInput where the data are not at hand."""
    if not DATA.is_dir():
        raise BadInput("the certified problems are not at hand", where=str(DATA), todo="put them there")
    return sorted(MODELS)


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Solve all problems from both starts; see the module."""
    del plots
    rows = []
    for name in problems():
        found = [solve(name, start) for start in (0, 1)]
        parameters, deviations, extended = (min(digits) for digits in zip(*found, strict=True))
        label = f"{name}: digits of the standard deviations"
        rows.append(_row(f"{name}: digits of the parameters", parameters, PARAMETER_DIGITS))
        if name in BEYOND_DOUBLE:
            rows += [
                _row(f"{label} that residuals in double precision leave", deviations, None),
                _row(f"{label}, residuals in long double", extended, DEVIATION_DIGITS),
            ]
        else:
            rows.append(_row(label, deviations, DEVIATION_DIGITS))
    return rows


def _row(name: str, value: float, target: float | None) -> dict[str, Any]:
    ok = target is None or value >= target
    return {"name": name, "value": value, "unit": "", "target": target, "ok": ok}
