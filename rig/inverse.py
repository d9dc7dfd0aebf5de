"""Inverse kinematics: closed form for the common machine, a search for any other open chains."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rig.angles import FloatArray, direction_to_spherical, wrap
from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rig.description import Joint
    from rig.kinematics import Kinematics

_POLE = 1e-9
"""Sine of the polar angle below which an azimuth makes no difference that float64 angles could show."""

_MET_RAD = 1e-8
"""Largest miss of a direction that counts as met by the search."""

_RANDOM_STARTS = 29
_STEPS = 80


class _Branch(NamedTuple):
    """One way to a pose: joint angles, and how far they are beyond the limits at worst."""

    angles: FloatArray
    beyond_rad: float
    worst: int


def solutions(
    kinematics: Kinematics, wi: FloatArray, wo: FloatArray, near: FloatArray, where: Callable[[], str]
) -> list[FloatArray]:
    """Find the joint angles that bring lamp and camera to wi and wo, the nearest to `near` first.

    Parameters
    ----------
    kinematics : Kinematics
    wi, wo : ndarray, shape (3,)
        Unit vectors in the sample's frame.
    near : ndarray, shape (J,)
        Where the joints are, in radians.
    where : callable
        Gives the pose's name for messages.

    Returns
    -------
    list of ndarray, shape (J,)
        At least one.

    Raises
    ------
    Refused
        No joint angles within the limits do.
    """
    common = kinematics.common
    if common is None:
        return _search(kinematics, wi, wo, near, where)
    ways = common.branches(wi, wo, near, kinematics.reach_rad)
    branches = _into_limits(kinematics, list(ways), near)
    return _by_travel(kinematics, branches, near, where)


def beyond_limits(joint: Joint, angle_rad: float, where: str) -> Refused:
    """Describe a joint that would have to go beyond its limits."""
    low, high = joint.reach_deg
    return Refused(
        f"{joint.name} would have to turn to {math.degrees(angle_rad):.2f} deg, "
        f"beyond its limits {low:g} to {high:g} deg",
        where=where,
        todo="choose a pose within reach, or widen limits_deg in the rig file if the machine allows it",
    )


class CommonMachine(NamedTuple):
    """Places and signs of the four joints of the machine that has a closed form.

    The lamp leans about y, the camera turns about z and leans about y, the sample turns about z. A sign is -1
    where the joint's axis points the other way.
    """

    light: int
    azimuth: int
    elevation: int
    table: int
    signs: tuple[float, ...]

    @staticmethod
    def recognise(kinematics: Kinematics) -> CommonMachine | None:
        """Find the four joints in a machine; None if it is another one."""
        chains = (kinematics.light_chain, kinematics.camera_chain, kinematics.sample_chain)
        places = tuple(itertools.chain(*chains))
        if [len(chain) for chain in chains] != [1, 2, 1] or len(set(places)) != 4:
            return None
        expected = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        cosines = np.sum(kinematics.axes[list(places)] * expected, axis=1)
        if not np.all(np.abs(cosines) == 1.0):
            return None
        light, azimuth, elevation, table = places
        return CommonMachine(light, azimuth, elevation, table, tuple(cosines.tolist()))

    def branches(
        self, wi: FloatArray, wo: FloatArray, near: FloatArray, limits: FloatArray
    ) -> Iterator[FloatArray]:
        """Every way to the pose, without regard to limits or whole turns.

        Light along the normal leaves the table free. It stays where it is; should that take the camera out of
        reach, other ways leave the camera's azimuth as it is, or at a limit, and turn the table instead.
        """
        theta_i, phi_i = (float(angle) for angle in direction_to_spherical(wi))
        theta_o, phi_o = (float(angle) for angle in direction_to_spherical(wo))
        places = [self.light, self.azimuth, self.elevation, self.table]
        # Columns: near, low, high; the order of low and high does not matter below.
        _, azimuths, _, tables = np.column_stack([near, limits])[places] * np.reshape(self.signs, (4, 1))
        azimuth_is_free = math.sin(theta_o) < _POLE
        if math.sin(theta_i) >= _POLE:
            lamps = [(theta_i, -phi_i), (-theta_i, math.pi - phi_i)]
        elif azimuth_is_free:
            lamps = [(theta_i, tables[0])]
        else:
            turned = [azimuth - phi_o + half for azimuth in azimuths for half in (0.0, math.pi)]
            lamps = [(theta_i, table) for table in (tables[0], *turned)]
        for lean, table in lamps:
            if azimuth_is_free:
                cameras = [(azimuths[0], theta_o)]
            else:
                cameras = [(phi_o + table, theta_o), (phi_o + table + math.pi, -theta_o)]
            for azimuth, elevation in cameras:
                angles = np.empty(4)
                angles[places] = np.multiply((lean, azimuth, elevation, table), self.signs)
                yield angles


def _into_limits(
    kinematics: Kinematics, ways: Sequence[FloatArray] | FloatArray, near: FloatArray
) -> list[_Branch]:
    """Choose each joint's whole turns: within the limits and nearest to where it is, else least beyond."""
    angles = np.reshape(np.asarray(ways, dtype=np.float64), (-1, near.size))
    low, high = kinematics.reach_rad.T[:, None, :, None]
    turns = np.arange(math.floor(low.min() / math.tau), math.ceil(high.max() / math.tau) + 1)
    options = wrap(angles)[..., None] + math.tau * turns
    outside = np.maximum(np.maximum(low - options, options - high), 0.0)
    # Less than half a tick outside, the servo's nearest position is the limit itself.
    slack = kinematics.ticks_rad[:, None] / 2.0
    excess = np.where(outside < slack, 0.0, outside)
    pick = np.lexsort((np.abs(options - near[:, None]), outside, excess))[..., :1]
    beyond = np.take_along_axis(excess, pick, axis=-1)
    best = np.take_along_axis(options, pick, axis=-1)
    chosen = np.where(beyond > 0.0, best, np.clip(best, low, high))[..., 0]
    beyond = beyond[..., 0]
    worst = np.argmax(beyond, axis=-1)
    return [
        _Branch(row, float(excesses[joint]), int(joint))
        for row, excesses, joint in zip(chosen, beyond, worst, strict=True)
    ]


def _by_travel(
    kinematics: Kinematics, branches: list[_Branch], near: FloatArray, where: Callable[[], str]
) -> list[FloatArray]:
    reachable = [branch for branch in branches if branch.beyond_rad == 0.0]
    if not reachable:
        least = min(branches, key=lambda branch: branch.beyond_rad)
        raise beyond_limits(kinematics.joints[least.worst], float(least.angles[least.worst]), where())

    def travel(branch: _Branch) -> tuple[float, float]:
        # Rounded, so that equal travels stay equal and the first branch wins on every computer.
        distances = np.abs(branch.angles - near)
        return round(float(distances.max()), 9), round(float(distances.sum()), 9)

    return [branch.angles for branch in sorted(reachable, key=travel)]


def _search(
    kinematics: Kinematics, wi: FloatArray, wo: FloatArray, near: FloatArray, where: Callable[[], str]
) -> list[FloatArray]:
    """Find poses of any open chains by descent from many starts at once."""
    low, high = kinematics.reach_rad.T
    # A fixed seed: the same pose always gets the same answer.
    random = np.random.default_rng(0).uniform(low, high, size=(_RANDOM_STARTS, low.size))
    starts = np.vstack([near, kinematics.park_rad, np.zeros(low.size), random])
    ends, misses = _descend(kinematics, starts, wi, wo, bounded=False)
    branches = _into_limits(kinematics, ends[misses < _MET_RAD], near)
    if not any(branch.beyond_rad == 0.0 for branch in branches):
        # Joints to spare: the pose may be met by others where one is held at its limit.
        held, held_misses = _descend(kinematics, np.clip(starts, low, high), wi, wo, bounded=True)
        branches += _into_limits(kinematics, held[held_misses < _MET_RAD], near)
    if not branches:
        raise Refused(
            f"no joint angles reach it, the nearest miss is {math.degrees(float(misses.min())):.2f} deg",
            where=where(),
            todo="choose a pose that the joints in the rig file can reach",
        )
    return _by_travel(kinematics, branches, near, where)


def _descend(
    kinematics: Kinematics, starts: FloatArray, wi: FloatArray, wo: FloatArray, *, bounded: bool
) -> tuple[FloatArray, FloatArray]:
    """Descend from every start at once (Levenberg 1944, Marquardt 1963) to where both directions are met.

    Returns
    -------
    angles : ndarray, shape (S, J)
    misses : ndarray, shape (S,)
        Distance that is left, of the two directions together, in radians where it is small.
    """
    low, high = kinematics.reach_rad.T
    target = np.concatenate([wi, wo])

    def residuals(angles: FloatArray) -> FloatArray:
        return np.asarray(np.concatenate(kinematics.directions(angles), axis=-1) - target)

    angles = starts.copy()
    left = residuals(angles)
    cost = np.sum(left**2, axis=-1)
    damping = np.full(len(starts), 1e-3)
    for _ in range(_STEPS):
        slopes = np.concatenate(kinematics.derivatives(angles), axis=-1)  # (S, J, 6)
        normal = slopes @ np.swapaxes(slopes, -1, -2) + damping[:, None, None] * np.eye(low.size)
        step = np.linalg.solve(normal, slopes @ left[..., None])[..., 0]
        tried = angles - step
        if bounded:
            tried = np.clip(tried, low, high)
        tried_left = residuals(tried)
        tried_cost = np.sum(tried_left**2, axis=-1)
        better = tried_cost < cost
        angles[better], left[better], cost[better] = tried[better], tried_left[better], tried_cost[better]
        damping = np.clip(np.where(better, damping / 10.0, damping * 5.0), 1e-12, 1e6)
        if np.all(cost < 1e-30):
            break
    return angles, np.sqrt(cost)
