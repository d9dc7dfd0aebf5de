"""Kajiya's rendering equation in three-point form, solved on patches in float64 without a renderer.

Kajiya (1986, "The rendering equation", eq. 1) writes the light that goes from a point x' to a point x as

    I(x, x') = g(x, x') (e(x, x') + integral over all surfaces of rho(x, x', x'') I(x', x'') dx'')

with g = V/r^2: visible or not, over the distance squared. In radiometric terms I(x, x') = g L cos theta',
where L is the radiance that leaves x' towards x and theta' its angle from the normal there, and rho is f_r
times both cosines at x'. The integral is a sum over the nodes of a quadrature rule on every surface
(Nystroem's method). Light is followed event by event, so that each number of events between lamp and camera
is known on its own: L D E, L D D E, and so on.

It is the reference that faster methods and Mitsuba are held against, for scenes that are small enough: with N
nodes a Lambertian surface costs N per node, any other N^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

CHANNELS = 3
_TOUCHING = 1e-9
"""A shadow ray's ends, in units of its length, at which a surface does not block it: it lies there."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A flat surface with one bright side: a rectangle, or the ellipse inside it.

    Parameters
    ----------
    centre_mm : array_like, shape (3,)
        Its middle.
    across_mm, up_mm : array_like, shape (3,)
        Half its sides, at right angles; across x up is the normal of the side that reflects. Directions of
        `reflectance` are told in the frame of across, up and normal.
    reflectance : float or callable
        Albedo of a Lambertian surface, or (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    nodes : int
        Nodes of the rule along each side (of an ellipse: along the radius, and four times as many around).
    round_ : bool
        Whether it is the ellipse.
    """

    centre_mm: ArrayLike
    across_mm: ArrayLike
    up_mm: ArrayLike
    reflectance: float | Reflectance
    nodes: int
    round_: bool = False

    @cached_property
    def frame(self) -> Array:
        """Columns: unit vectors across, up, and the normal; shape (3, 3)."""
        across, up = unit(self.across_mm), unit(self.up_mm)
        return np.stack([across, up, np.cross(across, up)], axis=1)

    def rule(self) -> tuple[Array, Array]:
        """Return nodes (N, 3) in millimetres and their areas (N,) in square millimetres."""
        s, ds = np.polynomial.legendre.leggauss(self.nodes)
        if self.round_:
            turns = 4 * self.nodes
            radius, angle = np.sqrt((s + 1.0) / 2.0), 2.0 * np.pi * (np.arange(turns) + 0.5) / turns
            u, v = (np.outer(radius, wave(angle)).ravel() for wave in (np.cos, np.sin))
            share = np.repeat(ds / 2.0 / turns, turns) * np.pi
        else:
            u, v = (axis.ravel() for axis in np.meshgrid(s, s, indexing="ij"))
            share = np.outer(ds, ds).ravel()
        across, up = np.asarray(self.across_mm, dtype=np.float64), np.asarray(self.up_mm, dtype=np.float64)
        area = float(np.linalg.norm(np.cross(across, up)))
        return np.asarray(self.centre_mm) + u[:, None] * across + v[:, None] * up, share * area

    def blocks(self, start: Array, end: Array) -> NDArray[np.bool_]:
        """Tell which straight ways (..., 3) it stands in."""
        normal, way = self.frame[:, 2], end - start
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.sum((np.asarray(self.centre_mm) - start) * normal, axis=-1) / np.sum(way * normal, axis=-1)
            met = start + t[..., None] * way - np.asarray(self.centre_mm)
            u, v = (
                np.sum(met * axis, axis=-1) / np.sum(np.square(axis))
                for axis in (np.asarray(self.across_mm), np.asarray(self.up_mm))
            )
            inside = u * u + v * v < 1.0 if self.round_ else (np.abs(u) < 1.0) & (np.abs(v) < 1.0)
            return np.asarray((t > _TOUCHING) & (t < 1.0 - _TOUCHING) & inside)


@dataclass(frozen=True, eq=False)
class PointLamp:
    """A lamp of no size.

    Parameters
    ----------
    position_mm : array_like, shape (3,)
        Where it stands.
    intensity : float
        Radiant intensity, the same in all directions, in square millimetres times the unit of irradiance.
    """

    position_mm: ArrayLike
    intensity: float


class ThreePoint:
    """Light between surfaces, event by event.

    Parameters
    ----------
    surfaces : sequence of Surface
        All that reflects or blocks.
    lamp : PointLamp or sequence of PointLamp
        The light; several are the nodes of a lamp with a size.
    """

    def __init__(self, surfaces: Sequence[Surface], lamp: PointLamp | Sequence[PointLamp]) -> None:
        self._surfaces = tuple(surfaces)
        self._lamps = (lamp,) if isinstance(lamp, PointLamp) else tuple(lamp)
        rules = [surface.rule() for surface in self._surfaces]
        self._nodes = np.concatenate([nodes for nodes, _ in rules])
        self._areas = np.concatenate([areas for _, areas in rules])
        ends = np.cumsum([len(areas) for _, areas in rules])
        self._parts = [slice(end - len(areas), end) for end, (_, areas) in zip(ends, rules, strict=True)]

    def camera_radiance(self, surface: int, points_mm: Array, wo: Array, events: int) -> Array:
        """Radiance of points of a surface towards given directions.

        Parameters
        ----------
        surface : int
            Which one.
        points_mm : ndarray, shape (M, 3)
            Points of it.
        wo : ndarray, shape (M, 3)
            Unit vectors towards the camera, in the scene's frame; nothing is taken to stand in between.
        events : int
            Up to how many scattering events.

        Returns
        -------
        ndarray, shape (events, M, 3)
            Of the paths with 1, 2, ... events: LDE, LDDE, ...
        """
        frame, f_r = self._surfaces[surface].frame, _reflectance(self._surfaces[surface])
        out = wo @ frame
        radiance = np.zeros((events, len(points_mm), CHANNELS))
        for lamp in self._lamps:
            irradiance, wi = self._lit(lamp, points_mm, frame)
            radiance[0] += irradiance[:, None] * f_r(wi, out)
        sight = self._sight(points_mm, frame[:, 2])
        for number, leaving in enumerate(self._orders(points_mm, events - 1), start=1):
            for row, (point, direction) in enumerate(zip(points_mm, out, strict=True)):
                seen = np.flatnonzero(sight[row])
                wi = unit(self._nodes[seen] - point) @ frame
                f = f_r(wi, np.broadcast_to(direction, wi.shape))
                radiance[number, row] = np.sum(f * leaving[seen, row] * sight[row, seen, None], axis=0)
        return radiance

    def _orders(self, points_mm: Array, most: int) -> list[Array]:
        """Radiance (N, M, 3) of the nodes towards points after 1, 2, ... events."""
        if not most:
            return []
        sight = np.concatenate(
            [
                self._sight(self._nodes[part], surface.frame[:, 2])
                for part, surface in zip(self._parts, self._surfaces, strict=True)
            ]
        )
        targets = np.concatenate([self._nodes, points_mm])
        leaving = self._first(targets)
        orders = [leaving[:, len(self._nodes) :]]
        for _ in range(most - 1):
            leaving = self._next(leaving[:, : len(self._nodes)], sight, targets)
            orders.append(leaving[:, len(self._nodes) :])
        return orders

    def _first(self, targets: Array) -> Array:
        """Radiance (N, T, 3) of the nodes towards targets, of the lamp's light alone."""
        leaving = np.zeros((len(self._nodes), len(targets), CHANNELS))
        for part, surface in zip(self._parts, self._surfaces, strict=True):
            f_r, nodes = _reflectance(surface), self._nodes[part]
            out = unit(targets - nodes[:, None] + _nowhere(nodes, targets)) @ surface.frame
            for lamp in self._lamps:
                irradiance, wi = self._lit(lamp, nodes, surface.frame)
                f = f_r(np.broadcast_to(wi[:, None], out.shape).reshape(-1, 3), out.reshape(-1, 3))
                leaving[part] += irradiance[:, None, None] * f.reshape(leaving[part].shape)
        return leaving

    def _next(self, leaving: Array, sight: Array, targets: Array) -> Array:
        """One more event: radiance (N, T, 3) of the nodes lit by the radiance (N, N, 3) of all nodes."""
        after = np.zeros((len(self._nodes), len(targets), CHANNELS))
        for part, surface in zip(self._parts, self._surfaces, strict=True):
            # Node n receives from node s the radiance that s sends to n.
            arriving = sight[part, :, None] * np.swapaxes(leaving[:, part], 0, 1)
            if isinstance(surface.reflectance, float | int):
                after[part] = (surface.reflectance / np.pi * arriving.sum(axis=1))[:, None]
                continue
            for row, node in enumerate(self._nodes[part]):
                seen = np.flatnonzero(sight[part.start + row])
                wi = unit(self._nodes[seen] - node) @ surface.frame
                out = unit(targets - node + _nowhere(node, targets)) @ surface.frame
                pairs = np.broadcast_arrays(wi[:, None], out[None])
                f = surface.reflectance(*(pair.reshape(-1, 3) for pair in pairs))
                f = f.reshape(len(seen), len(targets), CHANNELS)
                after[part.start + row] = np.einsum("stc,sc->tc", f, arriving[row, seen])
        return after

    def _lit(self, lamp: PointLamp, points: Array, frame: Array) -> tuple[Array, Array]:
        """Irradiance (M,) of points of a surface by the lamp, and where it stands (M, 3) in their frame."""
        position = np.asarray(lamp.position_mm, dtype=np.float64)
        way = position - points
        wi = unit(way) @ frame
        lit = (wi[:, 2] > 0.0) & self._clear(points, np.broadcast_to(position, points.shape))
        return lit * lamp.intensity * np.maximum(wi[:, 2], 0.0) / np.sum(np.square(way), axis=-1), wi

    def _sight(self, points: Array, normal: Array) -> Array:
        """Projected solid angle (M, N) that each node stands for, seen from the points; zero if hidden."""
        way = self._nodes - points[:, None]
        squared = np.sum(np.square(way), axis=-1)
        apart = squared > 0.0
        squared = np.where(apart, squared, 1.0)
        cosine_here = way @ normal / np.sqrt(squared)
        cosine_there = np.empty_like(squared)
        for part, surface in zip(self._parts, self._surfaces, strict=True):
            cosine_there[:, part] = -(way[:, part] @ surface.frame[:, 2]) / np.sqrt(squared[:, part])
        facing = apart & (cosine_here > 0.0) & (cosine_there > 0.0)
        share = np.where(facing, cosine_here * cosine_there * self._areas / squared, 0.0)
        for part, surface in zip(self._parts, self._surfaces, strict=True):
            share[:, part] *= _closure(surface, points, normal, share[:, part].sum(axis=1))[:, None]
        clear = np.zeros(facing.shape, dtype=bool)
        rows, columns = np.nonzero(facing)
        clear[rows, columns] = self._clear(points[rows], self._nodes[columns])
        return np.where(clear, share, 0.0)

    def _clear(self, start: Array, end: Array) -> NDArray[np.bool_]:
        clear = np.ones(start.shape[:-1], dtype=bool)
        for surface in self._surfaces:
            clear &= ~surface.blocks(start, end)
        return clear


def _reflectance(surface: Surface) -> Reflectance:
    value = surface.reflectance
    if not isinstance(value, float | int):
        return value
    return lambda wi, _wo: np.full((len(wi), CHANNELS), value / np.pi)


def _closure(surface: Surface, points: Array, normal: Array, found: Array) -> Array:
    """Factor (M,) that makes a rectangle's shares at each point add up to its exact form factor.

    Where two surfaces meet at an edge the kernel is singular, and the rule's sum is wrong by as much as
    itself. The sum over a rectangle's directed edges (Baum, Rushmeier and Winget 1989, "Improving radiosity
    solutions through the use of analytically determined form-factors", eq. 8, after Lambert 1760) is exact
    for a rectangle wholly in front of the point; others are left as they are.
    """
    if surface.round_:
        return np.ones(len(points))
    centre, across, up = (
        np.asarray(a, dtype=np.float64) for a in (surface.centre_mm, surface.across_mm, surface.up_mm)
    )
    corners = centre + np.array([across + up, up - across, -across - up, across - up])
    way = corners - points[:, None]
    in_front = np.all(way @ normal >= 0.0, axis=1) & (way[:, 0] @ surface.frame[:, 2] < 0.0)
    following = np.roll(way, -1, axis=1)
    turn = np.cross(following, way)
    sine = np.linalg.norm(turn, axis=-1)
    angle = np.arctan2(sine, np.sum(way * following, axis=-1))
    exact = 0.5 * np.sum(angle * (turn @ normal) / np.where(sine > 0.0, sine, 1.0), axis=1)
    usable = in_front & (found > 0.0)
    return np.where(usable, exact / np.where(usable, found, 1.0), 1.0)


def _nowhere(nodes: Array, targets: Array) -> Array:
    """Any direction for a target that is the node itself: none goes there, and none must fail."""
    same = np.all(targets == np.asarray(nodes)[..., None, :], axis=-1)
    return np.asarray(same[..., None] * np.array([0.0, 0.0, 1.0]))
