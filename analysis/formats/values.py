"""Values that no surface has: what is left of numbers whose bytes were exchanged, shifted or overwritten."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

LARGEST = 1e15
"""In 1/sr. A mirror seen through the narrowest aperture, 1e-5 rad, has some 1e10."""

SMALLEST = 1e-15
"""In 1/sr. The best polished mirrors scatter some 1e-9."""


def require_brdf(samples: xr.Dataset, path: Path) -> None:
    """Refuse samples with a value beyond any, or with values of which most are next to nothing.

    Doubles or floats with their bytes in the other order are spread evenly over 600 or 80 decades: most of
    them lie outside of these limits.

    Raises
    ------
    BadInput
        Names the first such sample, counted from 0 as everywhere.
    """
    size = np.abs(samples["f_r"].to_numpy())
    beyond = np.argwhere(size > LARGEST)
    if len(beyond):
        value = samples["f_r"].to_numpy()[tuple(beyond[0])]
        raise BadInput(
            f"{value:.3g} 1/sr is no value of a BRDF",
            where=f"{path}: sample {beyond[0][0]}, channel {beyond[0][1]}",
            todo="the file is damaged, or its bytes are in the other order: copy or export it again",
        )
    tiny = np.count_nonzero((size > 0.0) & (size < SMALLEST))
    if 2 * tiny > np.count_nonzero(size):
        raise BadInput(
            f"{tiny} of its values are below {SMALLEST:g} 1/sr",
            where=str(path),
            todo="the bytes of its numbers are in the other order, or shifted: copy or export it again",
        )
