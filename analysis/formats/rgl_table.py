"""Evaluation of measured BSDF tables.

Dupuy & Jakob (2018), "An adaptive parameterization for efficient material acquisition and rendering".

A table holds, for each incident direction, values on a square of u = (u_x, u_y) that is warped onto half
vectors by the density `vndf`: u_x follows its conditional, u_y its marginal distribution. Half vectors have
the square coordinates x = sqrt(2 theta / pi), y = (phi + pi) / 2 pi, with phi relative to the light where the
sample is isotropic. The value times ndf(half vector) / (4 sigma(light)), if the flag `jacobian` is set, is
f_r cos(theta_o), as `measured` of Mitsuba 3 evaluates it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical, half_vector
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Mapping

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CHUNK = 50_000
"""Pairs of directions evaluated at a time: bounds the memory that a table of many wavelengths takes."""


class _Slices(NamedTuple):
    """For each pair of directions, the incident directions of the table around it and their weights."""

    number: Indices
    weight: Array


class Table:
    """A checked table.

    Parameters
    ----------
    tensors : mapping of str to ndarray
        What a tensor file holds.
    where : str
        The file, for errors.

    Raises
    ------
    BadInput
        If an array is missing, of the wrong shape, or holds what is not a finite number.
    """

    def __init__(self, tensors: Mapping[str, NDArray[Any]], where: str) -> None:
        self._tensors, self._where = tensors, where
        values_name = "spectra" if "spectra" in tensors else "rgb"
        self.theta_i = self._increasing("theta_i", np.pi / 2.0 + 1e-3)
        self.phi_i = self._increasing("phi_i", 2.0 * np.pi + 1e-3)
        incident = (self.phi_i.size, self.theta_i.size)
        values = self._grid(values_name, 5, incident)
        self.wavelength_nm = self._array("wavelengths", 1) if values_name == "spectra" else None
        expected = 3 if self.wavelength_nm is None else self.wavelength_nm.size
        if values.shape[2] != expected:
            raise BadInput(f"has {values.shape[2]} channels, not {expected}", where=f"{where}: {values_name}")
        self.values = values.reshape(-1, *values.shape[2:])
        density = self._grid("vndf", 4, incident)
        self._warp = _Warp(density.reshape(-1, *density.shape[2:]), f"{where}: vndf")
        self.ndf, self.sigma = self._grid("ndf", 2), self._grid("sigma", 2)
        flag = tensors.get("jacobian")
        if flag is None or flag.size != 1:
            raise BadInput("has no flag jacobian", where=where, todo="copy the file again")
        self.jacobian = bool(flag.reshape(-1)[0])
        if self.jacobian and (self.sigma <= 0.0).any():
            raise BadInput("is not positive everywhere", where=f"{where}: sigma")

    @property
    def isotropic(self) -> bool:
        """Whether the light's azimuth does not matter: no more than two are in the table."""
        return self.phi_i.size <= 2

    @property
    def wavelengths(self) -> list[float] | None:
        """Wavelengths of the channels in nm; None where they are linear RGB."""
        return None if self.wavelength_nm is None else [float(w) for w in self.wavelength_nm]

    def evaluate(self, wi: Array, wo: Array) -> Array:
        """Interpolate the table as renderers do.

        Parameters
        ----------
        wi, wo : ndarray, shape (N, 3)
            Unit directions to light and camera.

        Returns
        -------
        ndarray, shape (N, C)
            f_r cos(theta_o) in 1/sr, negative where the table is; 0 where light or camera is below the
            surface.
        """
        result = np.zeros((len(wi), self.values.shape[1]))
        above = np.flatnonzero((wi[:, 2] > 0.0) & (wo[:, 2] > 0.0))
        for start in range(0, above.size, CHUNK):
            rows = above[start : start + CHUNK]
            result[rows] = self._evaluate(*self._reduced(wi[rows], wo[rows]))
        return result

    def weight(self, wi: Array, wo: Array) -> Array:
        """Return what a node's value is multiplied with to give f_r cos(theta_o), shape (N,).

        Parameters
        ----------
        wi, wo : ndarray, shape (N, 3)
            Unit directions above the surface.
        """
        if not self.jacobian:
            return np.ones(len(wi))
        wi, wo = self._reduced(wi, wo)
        return self._weight(*self._places(wi, wo))

    def half_vectors(self) -> tuple[Array, Array, Array, Array]:
        """Return the half vectors that the table's own nodes are for.

        Nodes that repeat a half vector (the seam of the azimuth, the pole but once) are left out.

        Returns
        -------
        theta_i, phi_i, theta_h, phi_h : ndarray, shape (N,)
            Radians in the sample frame.
        """
        rows, columns = self.values.shape[2:]
        y, x = np.meshgrid(
            np.arange(rows - 1) / (rows - 1), np.arange(1, columns) / (columns - 1), indexing="ij"
        )
        u = np.stack([np.append(x.ravel(), 0.0), np.append(y.ravel(), 0.5)], axis=-1)
        place = np.stack([self._warp.sample(u, index) for index in range(len(self.values))])
        theta_i = np.tile(self.theta_i, self.phi_i.size)[:, None]
        phi_i = np.repeat(self.phi_i, self.theta_i.size)[:, None]
        theta_h = place[..., 0] ** 2 * (np.pi / 2.0)
        phi_h = (2.0 * place[..., 1] - 1.0) * np.pi + (phi_i if self.isotropic else 0.0)
        spread = np.broadcast_arrays(theta_i, phi_i, theta_h, phi_h)
        return tuple(angle.reshape(-1) for angle in spread)  # type: ignore[return-value]

    def _evaluate(self, wi: Array, wo: Array) -> Array:
        light, half = self._places(wi, wo)
        slices = self._slices(*direction_to_spherical(wi))
        value = _lookup(self.values, self._warp.invert(half, slices), slices)
        if self.jacobian:
            value *= self._weight(light, half)[:, None]
        return value

    def _places(self, wi: Array, wo: Array) -> tuple[Array, Array]:
        """Square coordinates of light and half vector, shape (N, 2)."""
        theta_i, phi_i = direction_to_spherical(wi)
        theta_h, phi_h = direction_to_spherical(half_vector(wi, wo))
        half = _square(theta_h, phi_h - phi_i if self.isotropic else phi_h)
        half[:, 1] -= np.floor(half[:, 1])
        return _square(theta_i, phi_i), half

    def _weight(self, light: Array, half: Array) -> Array:
        return np.asarray(_bilinear(self.ndf, half) / (4.0 * _bilinear(self.sigma, light)))

    def _reduced(self, wi: Array, wo: Array) -> tuple[Array, Array]:
        """Bring the light into the part of the azimuths that a symmetric anisotropic table covers."""
        parts = 1 if self.isotropic else round(2.0 * np.pi / (self.phi_i[-1] - self.phi_i[0]))
        if parts < 2:
            return wi, wo
        sign_y = -np.copysign(1.0, wi[:, 1])
        sign_x = -np.copysign(1.0, wi[:, 0]) if parts == 4 else sign_y
        turn = np.stack([sign_x, sign_y, np.ones(len(wi))], axis=-1)
        return wi * turn, wo * turn

    def _slices(self, theta_i: Array, phi_i: Array) -> _Slices:
        """Weights of the four incident directions around each light."""
        theta_index, theta_weight = _interval(self.theta_i, theta_i)
        phi_index, phi_weight = _interval(self.phi_i, phi_i)
        index, weight = [], []
        for step_phi in (0, 1):
            for step_theta in (0, 1):
                index.append(
                    np.minimum(phi_index + step_phi, self.phi_i.size - 1) * self.theta_i.size
                    + np.minimum(theta_index + step_theta, self.theta_i.size - 1)
                )
                weight.append(
                    (phi_weight if step_phi else 1.0 - phi_weight)
                    * (theta_weight if step_theta else 1.0 - theta_weight)
                )
        return _Slices(np.stack(index, -1), np.stack(weight, -1))

    def _array(self, name: str, dimensions: int) -> Array:
        if name not in self._tensors:
            raise BadInput(f"has no field {name}", where=self._where, todo="is it a measured BSDF?")
        array = self._tensors[name]
        if array.ndim != dimensions or array.dtype.kind != "f":
            raise BadInput(f"has {array.ndim} dimensions of {array.dtype}", where=f"{self._where}: {name}")
        if not np.isfinite(array).all():
            place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            raise BadInput(f"is not a finite number at {place}", where=f"{self._where}: {name}")
        return array.astype(np.float64)

    def _increasing(self, name: str, largest: float) -> Array:
        angles = self._array(name, 1)
        if (np.diff(angles) <= 0.0).any() or np.abs(angles).max() > largest:
            raise BadInput("is not a list of increasing angles in radians", where=f"{self._where}: {name}")
        return angles

    def _grid(self, name: str, dimensions: int, incident: tuple[int, int] | None = None) -> Array:
        array = self._array(name, dimensions)
        if min(array.shape[-2:]) < 2 or (incident is not None and array.shape[:2] != incident):
            raise BadInput(f"has the shape {array.shape}", where=f"{self._where}: {name}")
        return array


class _Warp:
    """The warp of each incident direction: bilinear densities, (slices, rows, columns)."""

    def __init__(self, density: Array, where: str) -> None:
        rows_between = 0.5 * (density[:, :, 1:] + density[:, :, :-1])
        conditional = np.concatenate([np.zeros((*density.shape[:2], 1)), rows_between.cumsum(-1)], -1)
        row = conditional[:, :, -1]
        columns_between = 0.5 * (row[:, 1:] + row[:, :-1])
        marginal = np.concatenate([np.zeros((len(row), 1)), columns_between.cumsum(-1)], -1)
        total = marginal[:, -1]
        if (density < 0.0).any() or (total <= 0.0).any():
            raise BadInput("is no density: negative, or zero everywhere", where=where)
        self._density = density / total[:, None, None]
        self._conditional = conditional / total[:, None, None]
        self._row = row / total[:, None]
        self._marginal = marginal / total[:, None]

    def invert(self, place: Array, slices: _Slices) -> Array:
        """Find the u, shape (N, 2), that is warped to a place, shape (N, 2)."""
        rows, columns = self._density.shape[1:]
        x, y = place[:, 0] * (columns - 1), place[:, 1] * (rows - 1)
        i, j = np.clip(x.astype(int), 0, columns - 2), np.clip(y.astype(int), 0, rows - 2)
        x, y = x - i, y - j

        def at(array: Array, *where: Indices) -> Array:
            return np.asarray(
                sum(w * array[(s, *where)] for s, w in zip(slices.number.T, slices.weight.T, strict=True))
            )

        left = (1.0 - y) * at(self._density, j, i) + y * at(self._density, j + 1, i)
        right = (1.0 - y) * at(self._density, j, i + 1) + y * at(self._density, j + 1, i + 1)
        before = (1.0 - y) * at(self._conditional, j, i) + y * at(self._conditional, j + 1, i)
        first, second = at(self._row, j), at(self._row, j + 1)
        whole = (1.0 - y) * first + y * second
        along = before + x * (left + 0.5 * x * (right - left))
        with np.errstate(invalid="ignore", divide="ignore"):
            u_x = np.where(whole > 0.0, along / whole, 0.0)
        u_y = at(self._marginal, j) + y * (first + 0.5 * y * (second - first))
        inside: Array = np.clip(np.stack([u_x, u_y], axis=-1), 0.0, 1.0)
        return inside

    def sample(self, u: Array, index: int) -> Array:
        """Warp u, shape (N, 2), for one incident direction of the table."""
        density, conditional = self._density[index], self._conditional[index]
        row, marginal = self._row[index], self._marginal[index]
        rows, columns = density.shape
        j = np.clip(np.searchsorted(marginal, u[:, 1], side="right") - 1, 0, rows - 2)
        y = _within(u[:, 1] - marginal[j], row[j], row[j + 1])
        wanted = u[:, 0] * ((1.0 - y) * row[j] + y * row[j + 1])
        between = (1.0 - y)[:, None] * conditional[j] + y[:, None] * conditional[j + 1]
        i = np.clip((between <= wanted[:, None]).sum(-1) - 1, 0, columns - 2)
        left = (1.0 - y) * density[j, i] + y * density[j + 1, i]
        right = (1.0 - y) * density[j, i + 1] + y * density[j + 1, i + 1]
        x = _within(wanted - between[np.arange(len(u)), i], left, right)
        return np.stack([(i + x) / (columns - 1), (j + y) / (rows - 1)], axis=-1)


def _within(area: Array, first: Array, second: Array) -> Array:
    """Solve first t + (second - first) t^2 / 2 = area for t in [0, 1], stably."""
    root = np.sqrt(np.maximum(first**2 + 2.0 * area * (second - first), 0.0))
    below = first + root
    return np.clip(np.where(below > 0.0, 2.0 * area / np.where(below > 0.0, below, 1.0), 0.0), 0.0, 1.0)


def _square(theta: Array, phi: Array) -> Array:
    """Square coordinates of directions, shape (N, 2)."""
    return np.stack([np.sqrt(theta * (2.0 / np.pi)), (phi + np.pi) / (2.0 * np.pi)], axis=-1)


def _interval(nodes: Array, value: Array) -> tuple[Indices, Array]:
    """Index of the node below each value, and the weight of the next node."""
    if nodes.size == 1:
        return np.zeros(value.shape, dtype=np.intp), np.zeros(value.shape)
    index = np.clip(np.searchsorted(nodes, value, side="right") - 1, 0, nodes.size - 2)
    return index, np.clip((value - nodes[index]) / (nodes[index + 1] - nodes[index]), 0.0, 1.0)


def _corners(shape: tuple[int, ...], place: Array) -> list[tuple[Indices, Indices, Array]]:
    """Rows, columns and weights of the four nodes around places in the unit square."""
    rows, columns = shape
    x, y = place[:, 0] * (columns - 1), place[:, 1] * (rows - 1)
    i, j = np.clip(x.astype(int), 0, columns - 2), np.clip(y.astype(int), 0, rows - 2)
    x, y = x - i, y - j
    return [
        (j, i, (1.0 - y) * (1.0 - x)),
        (j, i + 1, (1.0 - y) * x),
        (j + 1, i, y * (1.0 - x)),
        (j + 1, i + 1, y * x),
    ]


def _bilinear(grid: Array, place: Array) -> Array:
    total: Array = np.sum([weight * grid[j, i] for j, i, weight in _corners(grid.shape, place)], axis=0)
    return total


def _lookup(values: Array, place: Array, slices: _Slices) -> Array:
    """Interpolate values (slices, channels, rows, columns), shape (N, channels)."""
    result = np.zeros((len(place), values.shape[1]))
    for j, i, weight in _corners(values.shape[2:], place):
        for index, share in zip(slices.number.T, slices.weight.T, strict=True):
            if share.any():
                result += (weight * share)[:, None] * values[index, :, j, i]
    return result
