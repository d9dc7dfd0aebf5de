"""What the parts of a machine must agree on, beyond each field's own range."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rig.rig_errors import cross_field, nearest
from rig.servo_models import MODELS
from rig.solids import BASE, Box, Sphere
from rig.ticks import TICKS_PER_TURN

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pydantic_core import PydanticCustomError

    from rig.description import Joint, Rig


def contradictions(rig: Rig) -> Iterator[PydanticCustomError]:
    """Find what the parts of a machine cannot know of each other, most basic first.

    Parameters
    ----------
    rig : Rig
        Its fields are valid one by one.

    Yields
    ------
    PydanticCustomError
        Of `rig.rig_errors.cross_field`.
    """
    yield from _duplicates(rig)
    for place, joint in enumerate(rig.joints):
        yield from _joint_contradictions(joint, f"joints[{place}]")
    yield from _arm_contradictions(rig)
    yield from _station_contradictions(rig)
    yield from _solid_contradictions(rig)
    yield from _supervision_contradictions(rig)
    camera = rig.camera
    if camera.shortest_exposure_s > camera.longest_exposure_s:
        yield cross_field(
            "camera.shortest_exposure_s",
            camera.shortest_exposure_s,
            f"at most longest_exposure_s = {camera.longest_exposure_s:g}",
        )
    if camera.kind == "gphoto" and rig.lamp.mode != "BULB":
        yield cross_field(
            "lamp.mode", rig.lamp.mode, 'BULB: a camera of kind "gphoto" needs light that burns'
        )
    column, row = camera.principal_point_px
    if not (-0.5 <= column <= camera.width_px - 0.5 and -0.5 <= row <= camera.height_px - 0.5):
        yield cross_field(
            "camera.principal_point_px",
            [column, row],
            f"a point inside the frame of {camera.width_px} x {camera.height_px} pixels",
        )


def _duplicates(rig: Rig) -> Iterator[PydanticCustomError]:
    names: dict[str, int] = {}
    ids: dict[int, int] = {}
    for place, joint in enumerate(rig.joints):
        if joint.name in names:
            yield cross_field(
                f"joints[{place}].name", joint.name, f"another name: joints[{names[joint.name]}] has it"
            )
        if joint.id in ids:
            yield cross_field(f"joints[{place}].id", joint.id, f"another id: joints[{ids[joint.id]}] has it")
        names[joint.name], ids[joint.id] = place, place


def _joint_contradictions(joint: Joint, where: str) -> Iterator[PydanticCustomError]:
    low, high = joint.limits_deg
    if joint.model not in MODELS:
        yield cross_field(f"{where}.model", joint.model, f"a known servo model{nearest(joint.model, MODELS)}")
    if not any(joint.axis):
        yield cross_field(f"{where}.axis", list(joint.axis), "an axis that is not zero")
    if not low < high:
        yield cross_field(f"{where}.limits_deg", [low, high], "low < high")
    if not low <= 0.0 <= high:
        yield cross_field(f"{where}.limits_deg", [low, high], "low <= 0 <= high, as zero_ticks is angle 0")
    deg_per_tick = 360.0 / TICKS_PER_TURN / joint.gear_ratio
    lowest = -joint.zero_ticks * deg_per_tick
    highest = (TICKS_PER_TURN - 1 - joint.zero_ticks) * deg_per_tick
    half_a_tick = deg_per_tick / 2.0
    if low < lowest - half_a_tick or high >= highest + half_a_tick:
        # Rounded inwards, so that a person can copy the numbers.
        reach = f"{math.ceil(lowest * 100) / 100:g} to {math.floor(highest * 100) / 100:g}"
        yield cross_field(f"{where}.limits_deg", [low, high], f"within one turn of the servo, {reach}")
    least, most = joint.reach_deg
    if not least <= 0.0 <= most:
        yield cross_field(f"{where}.overshoot_deg", joint.overshoot_deg, "less: 0 must leave room for it")
    if not low <= joint.park_deg <= high:
        yield cross_field(f"{where}.park_deg", joint.park_deg, f"within limits_deg, {low:g} to {high:g}")
    elif not least <= joint.park_deg <= most:
        allowed = f"within {least:g} to {most:g}, overshoot_deg inside limits_deg"
        yield cross_field(f"{where}.park_deg", joint.park_deg, allowed)


def _arm_contradictions(rig: Rig) -> Iterator[PydanticCustomError]:
    names = [joint.name for joint in rig.joints]
    used: dict[str, str] = {}
    for arm, chain in rig.arms:
        for place, name in enumerate(chain):
            field = f"arms.{arm}[{place}]"
            if name not in names:
                yield cross_field(field, name, f"the name of a joint{nearest(name, names)}")
            if name in chain[:place]:
                yield cross_field(field, name, "each joint once in an arm")
            if arm == "station" and name in used:
                yield cross_field(field, name, f"a joint of its own: arms.{used[name]} has it")
            used[name] = arm
    for place, name in enumerate(names):
        if name not in used:
            yield cross_field(
                f"joints[{place}].name", name, "a joint that arms names; this one moves nothing"
            )


def _station_contradictions(rig: Rig) -> Iterator[PydanticCustomError]:
    wheel = rig.station_joint
    if rig.stations and wheel is None:
        yield cross_field(
            "arms.station", [], f"the wheel's joint, as stations has {', '.join(sorted(rig.stations))}"
        )
    if wheel is None:
        return
    if not rig.stations:
        yield cross_field("stations", {}, f"at least one station, as arms.station names {wheel.name}")
    low, high = wheel.reach_deg
    for name, station in rig.stations.items():
        if not low <= station.angle_deg <= high:
            yield cross_field(
                f"stations.{name}.angle_deg",
                station.angle_deg,
                f"within the limits of {wheel.name}, {low:g} to {high:g}",
            )


def _supervision_contradictions(rig: Rig) -> Iterator[PydanticCustomError]:
    """Find bands of voltage that no supply could keep; 0 stands for what the model takes."""
    limits = rig.supervision
    for joint in rig.joints:
        least, most = MODELS[joint.model].input_v
        low, high = limits.voltage_min_v or least, limits.voltage_max_v or most
        if not low < high:
            field = "voltage_min_v" if limits.voltage_min_v else "voltage_max_v"
            allowed = f"a band of voltage for {joint.name}, not {low:g} to {high:g}"
            yield cross_field(f"supervision.{field}", getattr(limits, field), allowed)


def _solid_contradictions(rig: Rig) -> Iterator[PydanticCustomError]:
    names: dict[str, int] = {}
    links = [BASE, *(joint.name for joint in rig.arm_joints)]
    if rig.solids and BASE in links[1:]:
        place = rig.joint_index(BASE)
        yield cross_field(f"joints[{place}].name", BASE, "another name: it is the link that stands still")
    chains = (rig.arms.light, rig.arms.camera, rig.arms.sample)
    for place, solid in enumerate(rig.solids):
        where = f"solids[{place}]"
        if solid.name in names:
            yield cross_field(
                f"{where}.name", solid.name, f"another name: solids[{names[solid.name]}] has it"
            )
        names[solid.name] = place
        if solid.link not in links:
            yield cross_field(
                f"{where}.link",
                solid.link,
                f"{BASE} or a joint of the arms{nearest(solid.link, links)}; what a station wheel carries is "
                "described as the ring or disc that it sweeps",
            )
        below = {chain[: chain.index(solid.link)] for chain in chains if solid.link in chain}
        if len(below) > 1:
            yield cross_field(
                f"{where}.link", solid.link, "a joint that stands on the same joints in all arms"
            )
        if not isinstance(solid, Box | Sphere) and solid.from_mm == solid.to_mm:
            yield cross_field(f"{where}.to_mm", list(solid.to_mm), "another point than from_mm")
