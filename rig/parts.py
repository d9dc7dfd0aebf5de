"""The parts of a machine as `rig.toml` writes them, each field with its unit and range.

Degrees and millimetres, because people write this file; radians begin in `rig.kinematics`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")]
"""A name in a rig file: 1 to 40 letters, digits, underscores or hyphens."""


class Part(BaseModel):
    """Base of every part: frozen, strictly typed, no unknown fields, no NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Ports(Part):
    """Where this computer finds the machine. Outside the hash: a replugged adapter is the same machine."""

    servos: str = Field("", description="serial port of the servo bus, such as /dev/ttyUSB0 or COM3")
    lamp: str = Field("", description="serial port of the lamp controller, such as /dev/ttyACM0 or COM4")
    frames: Path = Field(
        Path("frames"), description="folder in which the camera's files arrive; relative to the rig file"
    )


class Bus(Part):
    """The servo bus."""

    baud: int = Field(1_000_000, ge=9_600, le=4_500_000, description="bit/s, 9600 to 4500000")
    torque_on_stop: Literal["hold", "off"] = Field(
        "hold", description='after a stop the servos "hold" their place or go limp ("off")'
    )
    settle_reads: int = Field(
        3, ge=1, le=100, description="equal position readings in a row that count as arrived, 1 to 100"
    )
    watchdog_s: float = Field(
        1.0,
        ge=0,
        le=2.5,
        description="arms on their way stop when the bus is silent for so long, 0 to 2.5 s; 0: never",
    )


class Joint(Part):
    """One servo and the axis that it turns."""

    name: Name = Field(description="unique name of letters, digits, _ and -, at most 40")
    id: int = Field(ge=0, le=252, description="unique servo id on the bus, 0 to 252")
    model: str = Field("XH430-W350", description="servo model, such as XH430-W350")
    axis: tuple[float, float, float] = Field(
        description="axis of rotation (x, y, z) in the frame of the joint below, any length but zero; "
        "a positive angle turns right-handed about it"
    )
    zero_ticks: int = Field(2048, ge=0, le=4095, description="servo position at angle zero, 0 to 4095 ticks")
    gear_ratio: float = Field(
        1.0, gt=0, le=1000, description="turns of the servo for one turn of the joint, above 0 to 1000"
    )
    limits_deg: tuple[float, float] = Field(
        description="lowest and highest angle in degrees, (low, high) with low <= 0 <= high, low < high, "
        "both within one turn of the servo"
    )
    speed_deg_s: float = Field(60.0, gt=0, le=2000, description="top speed, above 0 to 2000 degrees/s")
    acceleration_deg_s2: float = Field(
        120.0, gt=0, le=100_000, description="acceleration, above 0 to 100000 degrees/s^2"
    )
    tolerance_deg: float = Field(
        0.1, gt=0, le=10, description="distance from the goal that counts as arrived, above 0 to 10 degrees"
    )
    park_deg: float = Field(0.0, description="angle when parked, in degrees, within limits_deg")
    approach: Literal["direct", "from_below", "from_above"] = Field(
        "direct",
        description='"direct", or always from the same side against backlash: "from_below", "from_above"',
    )
    overshoot_deg: float = Field(
        1.0,
        gt=0,
        le=45,
        description="where a one-sided approach begins, above 0 to 45 degrees from the goal",
    )

    @property
    def reach_deg(self) -> tuple[float, float]:
        """Lowest and highest angle of a pose: inside the limits by the overshoot of a one-sided approach."""
        low, high = self.limits_deg
        if self.approach == "from_below":
            return low + self.overshoot_deg, high
        return low, high - self.overshoot_deg * (self.approach == "from_above")


class Arms(Part):
    """The chains of joints, named from the base to the tip."""

    light: tuple[str, ...] = Field(description="joints that carry the lamp, base to tip")
    camera: tuple[str, ...] = Field(description="joints that carry the camera, base to tip")
    sample: tuple[str, ...] = Field((), description="joints that turn the sample, base to tip")
    station: tuple[str, ...] = Field(
        (), max_length=1, description="the wheel that brings a station to the centre: at most one joint"
    )


class Lamp(Part):
    """The light source: a small disc that faces the sample's centre."""

    distance_mm: float = Field(500.0, gt=0, le=100_000, description="lamp to sample, above 0 to 100000 mm")
    diameter_mm: float = Field(5.0, gt=0, le=1000, description="lit disc, above 0 to 1000 mm")
    mode: Literal["BULB", "WIDTH", "LAMP"] = Field(
        "BULB", description="what times an exposure: BULB shutter, WIDTH of the trigger, LAMP lit for so long"
    )
    level: float = Field(1.0, gt=0, le=1, description="brightness, above 0 to 1")
    watchdog_s: float = Field(
        2.0, ge=0.1, le=60, description="light off when the line is silent for so long, 0.1 to 60 s"
    )
    warm_up_s: float = Field(
        0.0, ge=0, le=86_400, description="time to burn in before measuring, 0 to 86400 s"
    )
    monitor_band: float = Field(
        0.1,
        gt=0,
        le=1,
        description="share by which the photodiode may differ from the level, above 0 to 1; "
        "a frame with less or more light does not count",
    )
    u_monitor: float = Field(
        0.0005,
        ge=0,
        le=1,
        description="relative standard uncertainty of a ratio of two of the photodiode's readings, 0 to 1",
    )
    spectrum: str = Field(
        "",
        description="table of its relative power over nm, a file or colour:NAME, for the twin; empty: even",
    )


class Camera(Part):
    """The camera: a pinhole that faces the sample's centre. The first pixel's centre is (0, 0)."""

    kind: Literal["hotfolder", "gphoto"] = Field(
        "hotfolder",
        description="hotfolder: triggered by the lamp controller, RAW files arrive in ports.frames; "
        "gphoto: on USB, triggered and downloaded into ports.frames by this program",
    )
    serial: str = Field("", description="serial number that every file must carry; empty: not checked")
    distance_mm: float = Field(
        600.0, gt=0, le=100_000, description="entrance pupil to sample, above 0 to 100000 mm"
    )
    width_px: int = Field(128, ge=2, le=65_535, description="columns of the RAW frame, 2 to 65535 pixels")
    height_px: int = Field(96, ge=2, le=65_535, description="rows of the RAW frame, 2 to 65535 pixels")
    focal_length_px: float = Field(
        2400.0, gt=0, le=1e7, description="focal length over pixel pitch, above 0 to 1e7 pixels"
    )
    principal_point_px: tuple[float, float] = Field(
        (63.5, 47.5), description="(column, row) of the optical axis in pixels, inside the frame"
    )
    distortion: tuple[float, float, float, float, float] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0), description="OpenCV's k1, k2, p1, p2, k3, without unit"
    )
    u_distortion_px: float = Field(
        0.1,
        ge=0,
        le=1000,
        description="standard uncertainty of the lens model, pixels, where it bends",
    )
    aperture_diameter_mm: float = Field(10.0, gt=0, le=1000, description="entrance pupil, above 0 to 1000 mm")
    focus_distance_mm: float = Field(
        0.0, ge=0, le=1e6, description="entrance pupil to the plane in focus, up to 1e6 mm; 0: the sample's"
    )
    file_timeout_s: float = Field(
        10.0, gt=0, le=3600, description="wait for a file after the exposure, above 0 to 3600 s"
    )
    shortest_exposure_s: float = Field(1e-4, ge=1e-5, le=600, description="0.00001 to 600 s")
    longest_exposure_s: float = Field(
        60.0, ge=1e-5, le=600, description="0.00001 to 600 s, not below shortest_exposure_s"
    )
    exposure_steps_per_stop: int = Field(
        3, ge=1, le=1000, description="exposure times per factor of two, 1 to 1000"
    )
    sensitivity: str = Field(
        "", description="table of R, G, B over nm, a file or colour:NAME, for the twin; empty: even"
    )


class Sample(Part):
    """The flat sample at the centre."""

    diameter_mm: float = Field(50.0, gt=0, le=10_000, description="measured disc, above 0 to 10000 mm")


class Station(Part):
    """One place on the station wheel."""

    angle_deg: float = Field(
        description="wheel angle that brings it to the centre, degrees, within its limits"
    )
    kind: Literal["white", "trap", "sample"] = Field(description="white reference, light trap, or sample")


class White(Part):
    """The white reference, where `calibration/white.toml` has no certificate of it."""

    rho: float = Field(0.99, gt=0, le=1, description="8 deg/hemispherical reflectance, above 0 to 1")
    u_rho: float = Field(0.0005, ge=0, le=1, description="its standard uncertainty (k = 1), 0 to 1")
    u_uniformity: float = Field(
        0.0005,
        ge=0,
        le=1,
        description="relative standard deviation of its reflectance over the plate, 0 to 1",
    )


class Trap(Part):
    """The light trap, which shows what light comes from elsewhere than the sample."""

    rho: float = Field(0.001, ge=0, lt=0.5, description="its own reflectance factor, 0 to below 0.5")
    u_rho: float = Field(0.0003, ge=0, le=1, description="its standard uncertainty (k = 1), 0 to 1")


class Clearance(Part):
    """What keeps the arms apart."""

    min_separation_deg: float = Field(
        12.0, ge=0, le=180, description="least angle between light and camera, 0 to 180 degrees"
    )
    margin_mm: float = Field(
        10.0,
        ge=0.1,
        le=10_000,
        description="least distance of solids that move past each other, 0.1 to 10000 mm",
    )
    lag_deg: float = Field(
        0.0,
        ge=0,
        le=360,
        description="a joint that is farther than this off the way that was checked stops all arms, "
        "0 to 360 degrees; 0: what margin_mm allows where there are solids",
    )


class Supervision(Part):
    """Levels that are logged with every pose; one out of its band pauses the capture until it is back."""

    temperature_margin_deg_c: float = Field(
        10.0,
        ge=1,
        le=50,
        description="pause when a servo comes so near to its own temperature limit, 1 to 50 degrees C",
    )
    voltage_min_v: float = Field(
        0.0,
        ge=0,
        le=60,
        description="pause when a servo's supply is below, 0 to 60 V; 0: what its model takes",
    )
    voltage_max_v: float = Field(
        0.0,
        ge=0,
        le=60,
        description="pause when a servo's supply is above, 0 to 60 V; 0: what its model takes",
    )
    load_max: float = Field(
        0.8,
        gt=0,
        le=1,
        description="pause when a standing servo takes more of its current limit, a share above 0 to 1",
    )
    settle_s: float = Field(
        900.0, ge=0, le=86_400, description="a pause that takes longer ends the run, 0 to 86400 s"
    )
    reference_tolerance: float = Field(
        0.01,
        gt=0,
        le=1,
        description="share by which the light of a reference pose may have changed after an interruption, "
        "above 0 to 1",
    )
