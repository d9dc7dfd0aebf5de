"""One-sided approaches against backlash: where the last push to a pose begins.

Backlash leaves a shaft between two ends of its play; a joint that is always pushed the same way last stands
at the same end, whatever it did before.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from rig.ticks import rad_to_ticks, tick_rad, ticks_to_rad

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.description import Joint, Rig

_SIGNS = {"direct": 0, "from_below": -1, "from_above": 1}


def lead_ticks(joint: Joint, goal: int) -> int:
    """Where a joint's approach to a goal begins, within its limits: the goal itself for a direct one."""
    overshoot = math.ceil(math.radians(joint.overshoot_deg) / tick_rad(joint))
    low, high = sorted(rad_to_ticks(joint, math.radians(limit)) for limit in joint.limits_deg)
    return min(max(goal + _SIGNS[joint.approach] * overshoot, low), high)


def comes_from_its_side(joint: Joint, present: int, goal: int) -> bool:
    """Whether a direct move of a joint is a one-sided approach already, long enough to take up its play."""
    lead = lead_ticks(joint, goal)
    return lead == goal or (present - lead) * (lead - goal) >= 0


def leads_rad(rig: Rig, angles_rad: FloatArray) -> FloatArray:
    """Find all poses from which the last push to K poses may begin.

    Which joints are pushed once more depends on where the arms come from, so there is a pose for every choice
    of the one-sided joints.

    Parameters
    ----------
    rig : Rig
    angles_rad : ndarray, shape (K, J)

    Returns
    -------
    ndarray, shape (S, K, J)
        S is 2 to the number of one-sided arm joints, less 1; 0 where all approaches are direct.
    """
    one_sided = [place for place, joint in enumerate(rig.arm_joints) if joint.approach != "direct"]
    led = angles_rad.copy()
    for place in one_sided:
        joint = rig.arm_joints[place]
        led[:, place] = [
            ticks_to_rad(joint, lead_ticks(joint, goal)) for goal in rad_to_ticks(joint, angles_rad[:, place])
        ]
    choices = list(itertools.product((False, True), repeat=len(one_sided)))[1:]
    leads = np.repeat(angles_rad[None], len(choices), axis=0)
    for lead, choice in zip(leads, choices, strict=True):
        chosen = list(itertools.compress(one_sided, choice))
        lead[:, chosen] = led[:, chosen]
    return leads
