"""What the wire process asks of the light process: one exposure, complete.

A frame is a function of this request and of nothing else: neither wall time nor earlier shots reach it.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FrameRequest:
    """One exposure that has ended, and everything that its picture depends on.

    Parameters
    ----------
    seed : int
        The twin's seed.
    station : str or None
        The station that the wheel holds under the camera, by its name in the rig file; None where the machine
        has no wheel or the wheel stands between two stations.
    ticks : dict of str to int
        The encoder tick that each shaft holds, by joint name, station wheel included.
    angles_rad : tuple of float
        The true angles of the arm joints, in the order of `rig.arm_joints`, sub-tick residual included.
    level : float
        Lamp level, 0 to 1.
    exposure_s : float
        The time that light reached the sensor, or in a dark frame would have, as asked (never scaled by the
        speed).
    shutter_open_s : float
        The time that the shutter was open: equal to `exposure_s` but in LAMP mode.
    lit : bool
        Whether the lamp was lit during the exposure.
    mode : str
        "BULB", "WIDTH" or "LAMP".
    shot_id : str
        The shot's ID; empty where the client gave none.
    shot : int
        Exposures completed since power-up, this one included. It names the file and does not reach the
        pixels.
    output : float
        Light that the lamp gave, over what it gives at that level when nothing is wrong with it.
    """

    seed: int
    station: str | None
    ticks: dict[str, int]
    angles_rad: tuple[float, ...]
    level: float
    exposure_s: float
    shutter_open_s: float
    lit: bool
    mode: str
    shot_id: str
    shot: int
    output: float = 1.0
