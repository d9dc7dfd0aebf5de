"""The twin's image sensor: radiance to electrons to counts, in float64, with everything that a real one adds.

The order follows EMVA 1288 (release 4, section 2): photo-electrons and dark electrons are Poisson, the well
saturates, the amplifier adds read noise, the converter quantises and clips. Each pixel has a response
(PRNU) and a dark rate of its own, fixed by the camera's serial number and the seed.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from capture.sensor import SensorModel

Array = NDArray[np.float64]

RGGB = ((0, 1), (1, 2))
"""Channel at each position of the 2 x 2 cell: red, green, green, blue."""

NOMINAL_FILL = 0.7
"""Part of the full well that a white of albedo 0.99 fills at normal incidence, level 1, in
`NOMINAL_EXPOSURE_S`."""

NOMINAL_EXPOSURE_S = 0.1
NOMINAL_RADIANCE = 0.99 / np.pi

CLIP_SIGMAS = 6.0
"""The stated clip level lies this many read noises below the level of a full well, so that no clipped count
passes."""


def derived_seed(*fields: object) -> int:
    """Return a seed that depends on every field and on nothing else.

    BLAKE2b (RFC 7693) over the fields' text: equal on every platform, unlike `hash`, and unlike a sum never
    equal for neighbouring requests. Floats are written exactly, by `repr`.

    Parameters
    ----------
    *fields : object
        Strings, numbers, None, and tuples of them.

    Returns
    -------
    int
        128 bits.
    """
    return int.from_bytes(hashlib.blake2b(repr(fields).encode(), digest_size=16).digest(), "little")


@dataclass(frozen=True)
class Sensor:
    """A colour sensor under an RGGB mosaic.

    Parameters
    ----------
    width_px, height_px : int
        Size of the mosaic.
    serial : str
        The camera's serial number.
    seed : int
        The twin's seed; with the serial number it fixes response and dark rate of each pixel.
    bits : int
        Depth of the converter, 14 or 12; gain and black level scale with it.
    full_well_e : float
        Electrons at which a pixel saturates.
    read_noise_e : float
        Standard deviation of the read noise, electrons.
    dark_current_e_per_s : float
        Dark electrons per second of an ordinary pixel.
    prnu : float
        Relative standard deviation of the pixels' responses.
    hot_fraction : float
        Part of the pixels that are hot.
    bend : float
        Share by which the response falls short of proportion at full well, in proportion to the charge.
    hot_rate_e_per_s : tuple of float
        Lowest and highest dark rate of hot pixels, drawn evenly in the logarithm.
    """

    width_px: int
    height_px: int
    serial: str
    seed: int = 0
    bits: int = 14
    full_well_e: float = 30000.0
    read_noise_e: float = 3.0
    dark_current_e_per_s: float = 0.5
    prnu: float = 0.005
    hot_fraction: float = 0.001
    hot_rate_e_per_s: tuple[float, float] = (200.0, 5000.0)
    bend: float = 0.0

    @property
    def gain_dn_per_e(self) -> float:
        """Counts per electron."""
        return float(0.5 * 2.0 ** (self.bits - 14))

    @property
    def black_dn(self) -> tuple[int, int, int, int]:
        """Black level at the four positions of the cell, row by row; whole DN, because LibRaw truncates."""
        scale = 2 ** (14 - self.bits)
        return (512 // scale, 516 // scale, 508 // scale, 520 // scale)

    @property
    def largest_dn(self) -> int:
        """Largest count that the converter can give."""
        return (1 << self.bits) - 1

    @property
    def clip_dn(self) -> float:
        """Count from which a sample may be clipped, black included: full well or converter, the lower."""
        noise_dn = CLIP_SIGMAS * self.read_noise_e * self.gain_dn_per_e
        full_e = self.full_well_e * (1.0 - self.bend)
        return float(
            min(
                self.largest_dn,
                np.floor(min(self.black_dn) + self.gain_dn_per_e * full_e - noise_dn),
            )
        )

    @property
    def electrons_per_radiance_s(self) -> float:
        """Photo-electrons per second and unit of radiance, of a pixel of mean response."""
        return NOMINAL_FILL * self.full_well_e / (NOMINAL_EXPOSURE_S * NOMINAL_RADIANCE)

    @cached_property
    def response(self) -> Array:
        """Relative response of each pixel, shape (height, width)."""
        rng = np.random.default_rng(derived_seed("response", self.seed, self.serial))
        return 1.0 + self.prnu * rng.standard_normal((self.height_px, self.width_px))

    @cached_property
    def dark_rate_e_per_s(self) -> Array:
        """Dark electrons per second of each pixel, shape (height, width)."""
        rng = np.random.default_rng(derived_seed("dark rate", self.seed, self.serial))
        shape = (self.height_px, self.width_px)
        hot = rng.random(shape) < self.hot_fraction
        low, high = np.log(self.hot_rate_e_per_s)
        return np.where(hot, np.exp(rng.uniform(low, high, shape)), self.dark_current_e_per_s)

    def mosaic(self, radiance: Array) -> Array:
        """Take at each position the channel of its filter.

        Parameters
        ----------
        radiance : ndarray, shape (height, width, 3)

        Returns
        -------
        ndarray, shape (height, width)
        """
        picked = np.empty((self.height_px, self.width_px))
        for row, channels in enumerate(RGGB):
            for col, channel in enumerate(channels):
                picked[row::2, col::2] = radiance[row::2, col::2, channel]
        return picked

    def expose(
        self,
        radiance: Array | None,
        exposure_s: float,
        rng: np.random.Generator,
        *,
        shutter_open_s: float | None = None,
    ) -> NDArray[np.uint16]:
        """Take one frame.

        Parameters
        ----------
        radiance : ndarray, shape (height, width, 3), or None
            Radiance per channel, in units in which a white of albedo rho at normal incidence and level 1 has
            rho/pi; None in the dark.
        exposure_s : float
            How long light fell on the sensor.
        rng : numpy.random.Generator
            Source of the noise.
        shutter_open_s : float, optional
            How long the sensor collected dark current; by default as long as light.

        Returns
        -------
        ndarray of uint16, shape (height, width)
            Counts, black included.
        """
        electrons = self.dark_rate_e_per_s * (exposure_s if shutter_open_s is None else shutter_open_s)
        if radiance is not None:
            light = self.electrons_per_radiance_s * exposure_s
            electrons = electrons + self.mosaic(radiance) * self.response * light
        # Far beyond a full well the exact mean no longer matters, and Poisson numbers have an upper limit.
        collected = rng.poisson(np.clip(electrons, 0.0, 4.0 * self.full_well_e)).astype(np.float64)
        collected = np.minimum(collected, self.full_well_e)
        collected *= 1.0 - self.bend * collected / self.full_well_e
        read = collected + self.read_noise_e * rng.standard_normal(collected.shape)
        counts = np.rint(read * self.gain_dn_per_e + self._black_mosaic)
        return np.clip(counts, 0, self.largest_dn).astype(np.uint16)

    @cached_property
    def _black_mosaic(self) -> Array:
        rows, cols = -(-self.height_px // 2), -(-self.width_px // 2)
        cell = np.asarray(self.black_dn, dtype=np.float64).reshape(2, 2)
        return np.tile(cell, (rows, cols))[: self.height_px, : self.width_px]

    def _bent(self) -> dict[str, Any]:
        """Bend of the counts to second order, as `capture.linearity.Bend` has it; empty without one."""
        if not self.bend:
            return {}
        return {
            "bend": (-self.bend, -(self.bend**2)),
            "bend_range_dn": self.gain_dn_per_e * self.full_well_e,
            "bend_error": self.bend**3,
        }

    def calibration(self) -> SensorModel:
        """Return what a perfect calibration of this sensor would find."""
        from capture.sensor import SensorModel

        return SensorModel(
            gain_dn_per_e=self.gain_dn_per_e,
            read_noise_dn=self.read_noise_e * self.gain_dn_per_e,
            clip_dn=self.clip_dn,
            black_dn=tuple(float(level) for level in self.black_dn),
            dark_current_dn_per_s=self.dark_current_e_per_s * self.gain_dn_per_e,
            camera_serial=self.serial,
            **self._bent(),
            note="the twin's own values",
        )
