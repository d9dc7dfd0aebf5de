"""What light costs: processor seconds of the steps that methods are made of.

Measured on the machine of the benchmark (two cores of a server of 2022, LLVM 19) by `gonio bench light`,
whose rows say how far predictions are from times. What depends on the material and is computed in float64 is
measured when it is first asked for, in about a millisecond; other machines are slower or faster in all
alike, and the choice only compares.
"""

from __future__ import annotations

import time
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from rig.angles import unit
from simulator.light.reflectance import closed_form_reflectance

if TYPE_CHECKING:
    from simulator.materials import Material

GEOMETRY_S = 2.0e-7
"""Of one pixel's or node's directions in float64."""
MITSUBA_VALUE_S = 3.0e-7
"""Of one f_r asked for through LLVM, to and from NumPy."""
ONE_BY_ONE_S = 4e-6
"""Of one f_r asked for in a scalar variant, from Python."""
_PAIRS, _TIMES = 1024, 2


def value_s(material: Material, *, vector: bool) -> float:
    """Return the time of one f_r of a material, by its closed form if there is one."""
    if material.has_closed_form:
        return _closed_form_s(material)
    return MITSUBA_VALUE_S if vector else ONE_BY_ONE_S


@cache
def _closed_form_s(material: Material) -> float:
    """Measure it: models differ by a factor of ten."""
    reflectance = closed_form_reflectance(material)
    rng = np.random.default_rng(0)
    wi, wo = (unit(rng.uniform([-1.0, -1.0, 0.1], 1.0, (_PAIRS, 3))) for _ in range(2))
    best = np.inf
    for _ in range(_TIMES + 1):
        begin = time.process_time()
        reflectance(wi, wo)
        best = min(best, time.process_time() - begin)
    return best / _PAIRS
