"""What light costs: processor seconds of the steps that methods are made of.

Measured by `gonio bench light` on two cores with LLVM 19; its rows say how far predictions are from times.
They are constants and not measured on the spot: the choice of a method decides a frame's last digits, and the
same exposure must give the same frame whatever else the computer does. A slower machine is slower in all
alike, and the choice only compares.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.tables import TableMaterial

if TYPE_CHECKING:
    from simulator.materials import Material

GEOMETRY_S = 2.0e-7
"""Of one pixel's or node's directions in float64."""
MODEL_VALUE_S = 3.0e-7
"""Of one f_r of a model in float64: 0.03 to 0.45 us over all of them."""
TABLE_VALUE_S = 1.1e-6
"""Of one f_r of a measured file in float64."""
MITSUBA_VALUE_S = 3.0e-7
"""Of one f_r asked for through LLVM, to and from NumPy."""
ONE_BY_ONE_S = 4e-6
"""Of one f_r asked for in a scalar variant, from Python."""


def value_s(material: Material, *, vector: bool) -> float:
    """Return the time of one f_r of a material, by its closed form if there is one."""
    if isinstance(material, TableMaterial):
        return TABLE_VALUE_S
    if material.has_closed_form:
        return MODEL_VALUE_S
    return MITSUBA_VALUE_S if vector else ONE_BY_ONE_S
