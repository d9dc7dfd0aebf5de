"""What to know about a merged pixel."""

from __future__ import annotations

from enum import IntFlag


class Flag(IntFlag):
    """What to know about a merged pixel, one bit each."""

    OVER_RANGE = 1
    """Clipped in every frame: the value, from the shortest exposure, is a lower bound."""
    UNDER_RANGE = 2
    """The value is less than its standard deviation."""
    HOT = 4
    """A hot pixel of the darks; its dark level is subtracted, its noise is its own."""
    NEIGHBOUR_CLIPPED = 8
    """In at least one frame another pixel of the 2 x 2 cell was clipped: that frame was left out here."""
    INCONSISTENT = 16
    """The frames disagree by more than their noise: something moved, flickered, or is not linear."""
    NEAR_CLIPPED_USED = 32
    """Such frames had to be used, the rest told too little: the value may be low by `SUSPECT_ERROR`."""
