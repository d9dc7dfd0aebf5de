"""f_r between scattered samples of an isotropic surface, with its uncertainty and a mask of the holes.

A smooth trend takes what changes over decades: the lobe, Fresnel's rise, the fall towards grazing. What is
left, the ratio of sample and trend, is interpolated by kriging in coordinates of the half vector. Where no
sample is near, those that reciprocity and mirror symmetry put there are asked; what remains is a hole: it
gets a value, because grids want one, and is marked.
"""

from __future__ import annotations

from analysis.interpolation.interpolant import Interpolant, Interpolated

__all__ = ["Interpolant", "Interpolated"]
