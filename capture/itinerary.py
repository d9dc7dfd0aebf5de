"""A plan on one machine: which poses it takes, in which order, how long that takes and how much disk.

Pure: nothing moves, nothing is written. `gonio plan` prints it, a capture carries it out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.feasible import Feasible, Obstacles, feasible
from capture.records import NO_FLAG, PlannedPose, Role, Visit
from capture.route import order_by_travel, path_s
from capture.travel import Travel, travel_past
from rig.angles import direction_to_spherical, half_difference
from rig.errors import BadInput, Refused
from rig.kinematics import Kinematics
from rig.motion import ServoProfile

if TYPE_CHECKING:
    from capture.plan import Plan
    from rig.angles import FloatArray
    from rig.description import Rig

FRAMES_PER_POSE = 1.3
"""Frames that a pose needs on average, for predictions."""

SETTLE_S = 0.05
"""Reading back that all arms stand, for each move, for predictions."""

FILE_S = 0.3
"""From the end of an exposure to a verified file, for predictions."""

BYTES_PER_PIXEL, BYTES_PER_FILE = 2, 4096

SPECULAR_DEG = 5.0
"""Half vectors this close to the normal count as near the mirror direction."""


@dataclass(frozen=True, eq=False)
class Itinerary:
    """What a machine makes of a plan.

    Attributes
    ----------
    plan : Plan
    rig : Rig
    feasible : Feasible
        All poses, and which the machine takes.
    repeats : int
        Poses that the plan names more than once.
    angles_rad : ndarray, shape (M, J)
        Joint angles of the poses taken, as they will be visited.
    order : ndarray of int, shape (M,)
        Rows of `angles_rad` in the order of shortest travel from the parked arms.
    travel : Travel
        What the moves in that order and back cost, with their ways round solids.
    """

    plan: Plan
    rig: Rig
    feasible: Feasible
    repeats: int
    angles_rad: FloatArray
    order: np.ndarray[Any, np.dtype[np.int64]]
    travel: Travel

    @property
    def roles(self) -> tuple[Role, ...]:
        """The passes with the lamp on, in their order."""
        white = (Role.WHITE,) if self.plan.plan.white == "poses" else ()
        trap = (Role.TRAP,) if self.plan.trap.every else ()
        return (*white, Role.SAMPLE, *trap)

    def rows_of(self, role: Role) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Rows of `angles_rad` that a pass visits, in the order of travel from the parked arms."""
        every = self.plan.trap.every
        if role is not Role.TRAP or every == 1:
            return self.order
        # The last one too: stray light is put together between poses, never beyond them.
        chosen = sorted({*range(0, len(self.order), every), len(self.order) - 1})
        return self.order[chosen]

    def planned(self) -> list[PlannedPose]:
        """Every pose of the plan, for the journal."""
        angles = {
            int(index): _tuple(row) for index, row in zip(self.feasible.taken, self.angles_rad, strict=True)
        }
        reasons = {refusal.index: f"{refusal.reason}: {refusal.detail}" for refusal in self.feasible.refusals}
        return [
            PlannedPose(index, _tuple(wi), _tuple(wo), angles.get(index), reasons.get(index))
            for index, (wi, wo) in enumerate(zip(self.feasible.wi, self.feasible.wo, strict=True))
        ]

    def visits(self) -> list[Visit]:
        """Every stay with the lamp on: one pass there, the next one back."""
        visits: list[Visit] = []
        for number, role in enumerate(self.roles):
            station = station_for(role, self.plan, self.rig)
            rows = self.rows_of(role)
            for row in rows if number % 2 == 0 else rows[::-1]:
                pose = int(self.feasible.taken[row])
                # A solid of the machine is in the way of whatever lies in the middle.
                flags = self.feasible.flags.get(pose, NO_FLAG)
                angles_rad = _tuple(self.angles_rad[row])
                visits.append(Visit(len(visits), role, pose, station, angles_rad, flags=flags))
        return visits

    def forecast(self) -> Forecast:
        """How long it takes, and how much disk."""
        rig, plan = self.rig, self.plan
        passes = len(self.roles)
        moves = sum(len(self.rows_of(role)) for role in self.roles)
        travel = self.travel.seconds(passes)
        frames = round(moves * FRAMES_PER_POSE) + 2 * plan.darks.count
        pixels = rig.camera.width_px * rig.camera.height_px
        duration_s = (
            travel + moves * SETTLE_S + frames * (plan.exposure.first_s + FILE_S) + rig.lamp.warm_up_s
        )
        return Forecast(
            poses=len(self.order),
            refused=len(self.feasible.refusals),
            refused_by=self.feasible.counts,
            marked_by=self.feasible.marked,
            detours=self.travel.detours(passes),
            repeats=self.repeats,
            frames=frames,
            travel_s=travel,
            duration_s=duration_s,
            disk_bytes=frames * (BYTES_PER_PIXEL * pixels + BYTES_PER_FILE),
        )

    def coverage(self) -> dict[str, float]:
        """Tell what the poses cover, in degrees and counts; empty without poses."""
        wi, wo = self.feasible.wi[self.feasible.taken], self.feasible.wo[self.feasible.taken]
        if not len(wi):
            return {}
        theta_i, theta_o = (np.degrees(direction_to_spherical(w)[0]) for w in (wi, wo))
        theta_h = np.degrees(half_difference(wi, wo)[0])
        normal = np.cross(wi, wo)[:, 2]
        return {
            "theta_i_min_deg": float(theta_i.min()),
            "theta_i_max_deg": float(theta_i.max()),
            "theta_o_min_deg": float(theta_o.min()),
            "theta_o_max_deg": float(theta_o.max()),
            "in_plane": int(np.sum(np.abs(normal) < 1e-6)),
            "near_specular": int(np.sum(theta_h < SPECULAR_DEG)),
            "light_directions": len(np.unique(np.round(wi, 9), axis=0)),
            "camera_directions": len(np.unique(np.round(wo, 9), axis=0)),
        }


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a plan costs.

    Attributes
    ----------
    poses, refused, repeats, frames : int
    refused_by, marked_by : dict
        How many are refused, and how many measured though they are spoiled, by reason.
    detours : int
        Moves that go round solids.
    travel_s, duration_s : float
    disk_bytes : int
    """

    poses: int
    refused: int
    refused_by: dict[str, int]
    marked_by: dict[str, int]
    detours: int
    repeats: int
    frames: int
    travel_s: float
    duration_s: float
    disk_bytes: int


def lay_out(plan: Plan, rig: Rig) -> Itinerary:
    """Lay a plan out on a machine.

    Parameters
    ----------
    plan : Plan
    rig : Rig

    Returns
    -------
    Itinerary

    Raises
    ------
    BadInput
        The plan asks for a station that the wheel does not have, or for an exposure that the camera does not.
    Refused
        The machine can take none of the poses, or not all where the plan wants all.
    """
    check_stations(plan, rig)
    _check_exposure(plan, rig)
    wi, wo, repeats = plan.directions()
    kinematics, obstacles = Kinematics(rig), Obstacles(rig)
    found = feasible(kinematics, wi, wo, obstacles, mark=plan.plan.spoiled == "mark")
    profile = ServoProfile.of(rig)
    order = order_by_travel(found.angles_rad, profile, kinematics.park_rad)
    angles = _turned_well(kinematics, found, order, profile, obstacles)
    found = replace(found, angles_rad=angles)
    found, order, travel = travel_past(obstacles.clearance, found, order, kinematics.park_rad)
    _check_refusals(plan, found)
    return Itinerary(plan, rig, found, repeats, found.angles_rad, order, travel)


def station_for(role: Role, plan: Plan, rig: Rig) -> str | None:
    """Station that a pass needs; None for a machine without a wheel."""
    if not rig.stations:
        return None
    if role is Role.SAMPLE:
        return plan.sample
    return next(name for name, station in rig.stations.items() if station.kind == role.value)


def check_stations(plan: Plan, rig: Rig) -> None:
    """Make sure that the wheel has what the plan needs.

    Raises
    ------
    BadInput
        It has not.
    """
    if not rig.stations:
        return
    samples = [name for name, station in rig.stations.items() if station.kind == "sample"]
    if plan.sample not in samples:
        raise BadInput(
            f"no sample station {plan.sample!r}",
            where=f"plan {plan.name}",
            todo=f"sample stations are {', '.join(samples) or 'none'}",
        )
    if plan.trap.every and all(station.kind != "trap" for station in rig.stations.values()):
        raise BadInput(
            "the wheel has no light trap",
            where=rig.name,
            todo='add a station of kind "trap", or leave [trap] out of the plan',
        )
    if plan.plan.white == "poses" and all(station.kind != "white" for station in rig.stations.values()):
        raise BadInput(
            "the wheel has no white reference",
            where=rig.name,
            todo='add a station of kind "white", or plan white = "none"',
        )


def _check_exposure(plan: Plan, rig: Rig) -> None:
    camera, first_s = rig.camera, plan.exposure.first_s
    if not camera.shortest_exposure_s <= first_s <= camera.longest_exposure_s:
        raise BadInput(
            f"exposure.first_s is {first_s:g} s",
            where=f"plan {plan.name}",
            todo=f"the camera takes {camera.shortest_exposure_s:g} to {camera.longest_exposure_s:g} s",
        )


def _check_refusals(plan: Plan, found: Feasible) -> None:
    refusals = found.refusals
    if not refusals or (plan.plan.refused == "skip" and len(found.taken)):
        return
    raise Refused(
        f"the machine cannot take {len(refusals)} of {len(found.wi)} poses, the first: {refusals[0].detail}",
        where=f"plan {plan.name}",
        todo='change them, or leave them out with refused = "skip" (--skip-refused)',
    )


def _turned_well(
    kinematics: Kinematics,
    found: Feasible,
    order: np.ndarray[Any, np.dtype[np.int64]],
    profile: ServoProfile,
    obstacles: Obstacles,
) -> FloatArray:
    """Solve the poses again along the way: an arm may get there on another branch with less travel.

    Where something stands in that branch's way, the pose keeps the angles that it has.
    """
    start = kinematics.park_rad
    near, again = start, np.empty_like(found.angles_rad)
    for row in order:
        pose = found.taken[row]
        near = again[row] = kinematics.solve(found.wi[pose], found.wo[pose], near)
    blocked = [obstacle is not None for obstacle in obstacles.at(again)]
    again[blocked] = found.angles_rad[blocked]
    before, after = (path_s(angles[order], profile, start) for angles in (found.angles_rad, again))
    return again if after < before else found.angles_rad


def _tuple(row: FloatArray) -> tuple[float, ...]:
    return tuple(float(number) for number in row)
