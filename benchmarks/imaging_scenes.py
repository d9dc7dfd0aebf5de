"""What the parts of the imaging benchmark share: one sensor, and frames of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from capture.sensor import SensorModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

GAIN, READ_DN, CLIP, BLACK = 0.4, 3.0, 16383, 512
SENSOR = SensorModel(GAIN, READ_DN, CLIP)
TIMES = np.array([0.001, 0.004, 0.016, 0.064, 0.256, 1.024])


def ramp(shape: tuple[int, int], low: float = 2.5, high: float = 7.0) -> NDArray[np.float32]:
    """Smooth radiance in DN/s between two powers of ten, by default up to the shortest frame's clip level."""
    rows = np.linspace(0.0, 1.0, shape[0], dtype=np.float32)[:, np.newaxis]
    cols = np.linspace(0.0, 1.0, shape[1], dtype=np.float32)[np.newaxis]
    return np.asarray(10.0 ** (low + (high - low) * (0.8 * cols + 0.2 * rows)), dtype=np.float32)


def expose(
    radiance: NDArray[np.floating] | float,
    shape: tuple[int, int],
    *,
    seed: int,
    times: NDArray[np.float64] = TIMES,
    exact: bool = False,
) -> list[NDArray[np.uint16]]:
    """Frames with shot and read noise on a pedestal.

    Parameters
    ----------
    radiance : ndarray or float
        In DN/s.
    shape : tuple of int
        Height and width.
    seed : int
        Of the noise.
    times : ndarray
        Exposure times in seconds.
    exact : bool
        Poisson's shot noise; else Gaussian with its variance, which is quick.
    """
    rng = np.random.default_rng(seed)
    frames = []
    for exposure_s in times:
        signal = np.broadcast_to(np.asarray(radiance * np.float32(exposure_s), np.float32), shape)
        if exact:
            counts = rng.poisson(np.asarray(radiance, np.float64) * exposure_s / GAIN, shape) * GAIN
            counts += rng.normal(0.0, READ_DN, shape)
        else:
            counts = rng.standard_normal(shape, dtype=np.float32) * np.sqrt(GAIN * signal + READ_DN**2)
            counts += signal
        frames.append(np.clip(np.rint(counts + BLACK), 0, CLIP).astype(np.uint16))
    return frames
