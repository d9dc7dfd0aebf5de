"""The plan: what to measure, as a TOML file that a person can read and a session can repeat.

A plan names generators of poses, not joint positions: the same plan runs on any machine, and each session
writes down the poses that it made of it. Importing this module loads pydantic.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from capture import poses
from rig.errors import BadInput
from rig.files import whole_file
from rig.parts import Part
from rig.rig_errors import explain

if TYPE_CHECKING:
    from rig.angles import FloatArray

_LARGEST_FILE = 20_000_000

Theta = Annotated[float, Field(ge=0.0, le=90.0)]
SignedTheta = Annotated[float, Field(ge=-90.0, le=90.0)]
Phi = Annotated[float, Field(ge=-360.0, le=360.0)]


ADDED_FIELDS: dict[str, tuple[str, ...]] = {"plan": ("spoiled",), "exposure": ("spare",)}
"""Fields younger than the format: with their default they leave the hash of a plan as it was."""

ADDED_PARTS = ("trap", "references")
"""Parts younger than the format: likewise."""


class Grid(Part):
    """Every combination of the angles."""

    kind: Literal["grid"] = "grid"
    theta_i_deg: tuple[Theta, ...] = Field(min_length=1, description="light, from the normal")
    theta_o_deg: tuple[Theta, ...] = Field(min_length=1, description="camera, from the normal")
    phi_deg: tuple[Phi, ...] = Field((180.0,), min_length=1, description="camera's azimuth minus the light's")
    phi_i_deg: tuple[Phi, ...] = Field((0.0,), min_length=1, description="light's azimuth")

    def directions(self) -> poses.Directions:
        """Directions of all its poses, (N, 3) each."""
        return poses.grid(
            np.radians(self.theta_i_deg),
            np.radians(self.theta_o_deg),
            np.radians(self.phi_deg),
            np.radians(self.phi_i_deg),
        )


class Sweep(Part):
    """Sweeps in the plane of incidence."""

    kind: Literal["sweep"] = "sweep"
    theta_i_deg: tuple[Theta, ...] = Field(min_length=1, description="light, from the normal")
    theta_o_deg: tuple[SignedTheta, ...] = Field(
        min_length=1, description="camera, from the normal, positive on the mirror's side"
    )
    phi_i_deg: Phi = Field(0.0, description="light's azimuth")

    def directions(self) -> poses.Directions:
        """Directions of all its poses, (N, 3) each."""
        return poses.sweep(
            np.radians(self.theta_i_deg), np.radians(self.theta_o_deg), math.radians(self.phi_i_deg)
        )


class Specular(Part):
    """Poses about the mirror direction."""

    kind: Literal["specular"] = "specular"
    theta_i_deg: tuple[Theta, ...] = Field(min_length=1, description="light, from the normal")
    offset_deg: tuple[SignedTheta, ...] = Field(
        (0.0,), min_length=1, description="camera beyond the mirror direction"
    )
    phi_i_deg: Phi = Field(0.0, description="light's azimuth")

    def directions(self) -> poses.Directions:
        """Directions of all its poses, (N, 3) each."""
        return poses.specular(
            np.radians(self.theta_i_deg), np.radians(self.offset_deg), math.radians(self.phi_i_deg)
        )


class Hemisphere(Part):
    """Camera directions spread evenly over a cap, for each light direction."""

    kind: Literal["hemisphere"] = "hemisphere"
    theta_i_deg: tuple[Theta, ...] = Field(min_length=1, description="light, from the normal")
    count: int = Field(ge=1, le=poses.LARGEST_SET, description="camera directions for each")
    theta_o_max_deg: Theta = Field(75.0, description="the cap's rim, from the normal")
    phi_i_deg: Phi = Field(0.0, description="light's azimuth")

    def directions(self) -> poses.Directions:
        """Directions of all its poses, (N, 3) each."""
        return poses.hemisphere(
            np.radians(self.theta_i_deg),
            self.count,
            math.radians(self.theta_o_max_deg),
            math.radians(self.phi_i_deg),
        )


class PoseList(Part):
    """Poses one by one."""

    kind: Literal["list"] = "list"
    directions_deg: tuple[tuple[Theta, Phi, Theta, Phi], ...] = Field(
        min_length=1, description="theta_i, phi_i, theta_o, phi_o of each"
    )

    def directions(self) -> poses.Directions:
        """Directions of all its poses, (N, 3) each."""
        return poses.listed(np.radians(self.directions_deg))


PoseSet = Annotated[Grid | Sweep | Specular | Hemisphere | PoseList, Field(discriminator="kind")]


class Head(Part):
    """What is measured, and what happens to poses that the machine cannot take."""

    name: str = Field(min_length=1, max_length=200, description="the session's title")
    sample: str = Field(
        pattern=r"^[A-Za-z0-9_-]{1,40}$", description="the sample's station, or its label without a wheel"
    )
    white: Literal["poses", "none"] = Field(
        "poses", description="shoot the white reference at the poses of the sample, or not at all"
    )
    refused: Literal["skip", "stop"] = Field(
        "skip", description="leave out and list the poses that the machine cannot take, or do not start"
    )
    spoiled: Literal["drop", "mark"] = Field(
        "drop",
        description="poses whose sample a solid shades or hides, or with the lamp in the picture: leave out "
        "as if the machine could not take them, or measure and mark them",
    )


class Exposure(Part):
    """How exposures are chosen."""

    snr: float = Field(30.0, gt=0, le=1e4, description="signal-to-noise ratio of one pixel in the dim part")
    first_s: float = Field(0.02, ge=1e-5, le=600, description="the very first exposure of a pass, seconds")
    max_frames: int = Field(4, ge=1, le=16, description="frames for one pose at most")
    spare: Literal["frames", "time"] = Field(
        "frames", description="what a bracket spares: the number of its frames, or the time they take"
    )


class Darks(Part):
    """Frames with the lamp off."""

    count: int = Field(
        3, ge=0, le=1000, description="dark frames at the shortest and at the longest exposure used"
    )


class Trap(Part):
    """The light trap in the sample's place, which shows the stray light."""

    every: int = Field(
        0,
        ge=0,
        le=poses.LARGEST_SET,
        description="at every so many poses in the order of travel, and the last; 1: at all, 0: not at all",
    )


class References(Part):
    """When references are shot again: as the drift asks for."""

    tolerance: float = Field(
        0.001,
        gt=0,
        le=1,
        description="relative error that drift since the last reference may have made, as predicted",
    )
    max_interval_s: float = Field(
        3600.0, ge=0, le=1e6, description="longest time between two references, seconds; 0: any"
    )


class Plan(Part):
    """A whole plan. Two plans are equal when their contents are."""

    version: Literal[1] = Field(1, description="of this format")
    plan: Head
    exposure: Exposure = Field(default_factory=Exposure)
    darks: Darks = Field(default_factory=Darks)
    trap: Trap = Field(default_factory=Trap)
    references: References = Field(default_factory=References)
    poses: tuple[PoseSet, ...] = Field(min_length=1)

    @property
    def name(self) -> str:
        """The session's title."""
        return self.plan.name

    @property
    def sample(self) -> str:
        """The sample's station, or its label without a wheel."""
        return self.plan.sample

    @property
    def hash(self) -> str:
        """SHA-256 (hex) of the content, blind to the file's layout, key order and comments."""
        content = self.model_dump(mode="json")
        for part, names in ADDED_FIELDS.items():
            given = content[part]
            defaults = type(getattr(self, part)).model_fields
            content[part] = {k: v for k, v in given.items() if k not in names or v != defaults[k].default}
        for part in ADDED_PARTS:
            if getattr(self, part) == type(getattr(self, part))():
                del content[part]
        return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()

    def directions(self) -> tuple[FloatArray, FloatArray, int]:
        """Expand the generators.

        Returns
        -------
        wi, wo : ndarray, shape (N, 3)
            All poses in the plan's order, each once.
        repeats : int
            How many were named more than once.

        Raises
        ------
        BadInput
            There are more than `poses.LARGEST_SET`.
        """
        sets = [generator.directions() for generator in self.poses]
        total = sum(len(wi) for wi, _ in sets)
        if total > poses.LARGEST_SET:
            raise BadInput(
                f"{total} poses", where=f"plan {self.name}", todo=f"ask for at most {poses.LARGEST_SET}"
            )
        return poses.without_repeats(
            np.concatenate([wi for wi, _ in sets]), np.concatenate([wo for _, wo in sets])
        )


def load_plan(path: str | Path) -> Plan:
    """Read a plan.

    Parameters
    ----------
    path : path
        The TOML file.

    Returns
    -------
    Plan

    Raises
    ------
    BadInput
        The file is missing, unreadable, not TOML, or no plan. One line names file, field, value, and what is
        allowed.
    """
    file = Path(path)
    try:
        if file.stat().st_size > _LARGEST_FILE:
            raise BadInput(f"larger than {_LARGEST_FILE} bytes", where=str(file), todo="give a plan")
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(
            error.strerror or "unreadable", where=str(file), todo="give a plan that `gonio plan` wrote"
        ) from None
    except (ValueError, RecursionError) as error:
        raise BadInput(f"not a TOML file: {error}", where=str(file), todo="mend that line") from None
    return plan_from(content, str(file))


def plan_from(content: dict[str, Any], where: str) -> Plan:
    """Make a plan from plain values, as a TOML file holds them.

    Parameters
    ----------
    content : dict
    where : str
        What to call it in an error.

    Raises
    ------
    BadInput
        It is no plan.
    """
    try:
        return Plan.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise explain(error, content, Plan, where) from None


def dump_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan that `load_plan` reads back equal.

    Raises
    ------
    BadInput, Refused
        The file cannot be written, or the disk is full.
    """
    import tomli_w

    text = tomli_w.dumps(plan.model_dump(mode="json"))
    with whole_file(path) as file:
        file.write_text(text, encoding="utf-8")
