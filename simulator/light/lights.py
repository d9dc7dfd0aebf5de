"""Light on its way in many poses at once, as bounds keep it: its start, what it lights, what is seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.light.hemisphere import hemisphere

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.light.scene import PlanarMirror

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CHANNELS = 3
RINGS, TURNS = 16, 10
"""Of the rules over the hemisphere."""
MARGIN = 1.05
"""What the integrals over the hemisphere may be wrong by: their rule does not know the lobe."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where light starts, in P poses.

    Attributes
    ----------
    lamp_mm : ndarray, shape (P, 3)
    wi : ndarray, shape (P, 3)
        Towards it from the sample, above the horizon.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    """

    lamp_mm: Array
    wi: Array
    reflectance: Reflectance

    @cached_property
    def thrown(self) -> tuple[Array, Array]:
        """The sample's albedo for this light, and its largest f_r times the other cosine; (P, C) each."""
        found = hemisphere(lambda wi, wo: self.reflectance(wo, wi), self.wi, rings=RINGS, turns=TURNS)
        return np.pi * found.least + MARGIN * found.rest, MARGIN * found.largest_cosine


class Lobe(NamedTuple):
    """What the sample makes of light from all directions, for L directions of the camera in each pose.

    Attributes
    ----------
    least, rest, largest : ndarray, shape (P, L, C)
        As in `simulator.light.hemisphere`.
    weights : ndarray, shape (P, L, N, C)
        As there.
    cells : ndarray of int, shape (P, L, N)
        The walls' cells in the directions of the weights.
    """

    least: Array
    rest: Array
    largest: Array
    weights: Array
    cells: Indices


@dataclass(frozen=True, eq=False)
class Light:
    """Bounds of light on its way, in P poses.

    Attributes
    ----------
    walls, most : ndarray, shape (P, cells, C or 1)
        Irradiance of the housing, where it was scattered last: mean and largest of each cell; one cell of
        zeros otherwise. One channel if it is grey.
    sample : ndarray, shape (P, C)
        Radiance of the sample times its cosine, where it was scattered last.
    flux : ndarray, shape (P, C), optional
        What the sample has sent to the walls that the light comes from, in all, where it is known.
    lamp_mm : ndarray, shape (P, 3), optional
        The lamp, or its image in the mirrors so far; None once the light has been scattered.
    mirror : PlanarMirror, optional
        The last mirror, if light came over one since it was scattered.
    mirrored : bool
        Whether it came over one, or over the sample's mirror-like part.
    kept : float
        What mirrors have left of it since.
    """

    walls: Array
    most: Array
    sample: Array
    flux: Array | None = None
    lamp_mm: Array | None = None
    mirror: PlanarMirror | None = None
    mirrored: bool = False
    kept: float = 1.0

    @classmethod
    def dark(cls, poses: int) -> Light:
        """Return no light."""
        walls = np.zeros((poses, 1, CHANNELS))
        return cls(walls, walls, np.zeros((poses, CHANNELS)))

    @property
    def by_cells(self) -> bool:
        """Whether it comes straight from walls that are known cell by cell."""
        return self.walls.shape[1] > 1 and not self.mirrored
