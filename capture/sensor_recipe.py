"""How many frames of what characterise a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capture.ptc import LARGEST_FILL

if TYPE_CHECKING:
    from capture.exposure import Shutter


@dataclass(frozen=True)
class Recipe:
    """How many frames of what.

    Attributes
    ----------
    levels : int
        Exposures of flats below saturation.
    lowest, highest : float
        Their range, as parts of saturation.
    over : tuple of float
        Exposures beyond it, as multiples.
    gain_to : float
        Relative uncertainty of the gain that the number of pairs aims at.
    most_pairs : int
        Of each level, whatever it aims at.
    longest_dark_s : float
        Of the dark exposures; as long as the longest flat at least.
    biases, darks : int
        Frames of the shortest dark exposure, and of each other.
    """

    levels: int = 20
    lowest: float = 0.04
    highest: float = 0.96
    over: tuple[float, ...] = (1.6, 4.0)
    gain_to: float = 1e-3
    most_pairs: int = 8
    longest_dark_s: float = 10.0
    biases: int = 16
    darks: int = 8

    def pairs(self, lit_pixels: int) -> int:
        """Pairs of each level: N pixels know a variance to sqrt(2 / N) of it."""
        used = max(LARGEST_FILL / (self.highest - self.lowest) * self.levels, 1.0)
        wanted = 2.0 / (self.gain_to**2 * max(lit_pixels, 1) * used)
        return max(1, min(self.most_pairs, math.ceil(wanted)))

    def flat_times_s(self, shutter: Shutter, full_s: float) -> tuple[float, ...]:
        """Exposures of flats, ascending, as far as the shutter has them."""
        fills = np.linspace(self.lowest, self.highest, self.levels)
        below = {shutter.at_most(fill * full_s) for fill in fills}
        below = {time for time in below if time <= self.highest * full_s}
        beyond = {next((t for t in shutter.times_s if t >= part * full_s), 0.0) for part in self.over}
        return tuple(sorted(below | (beyond - {0.0})))

    def dark_times_s(self, shutter: Shutter, longest_flat_s: float) -> tuple[float, ...]:
        """Exposures of darks, ascending: evenly spread, so that rate and bias are told apart."""
        longest = shutter.at_most(max(self.longest_dark_s, longest_flat_s))
        middle = {shutter.at_most(part * longest) for part in (0.25, 0.5)}
        return tuple(sorted({shutter.times_s[0], longest} | middle))
