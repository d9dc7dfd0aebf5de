"""Recipes: a laboratory's chain from readings to f_r as a list of named steps in a TOML file.

    title = "what it makes of what"
    source = "whose chain this is, and how it is known"
    reads = "RT-300S .xls"          # optional: the only format it is meant for

    [[step]]
    name = "blank"

    [[step]]
    name = "shadow_cut"
    polar_deg = 10.0
    azimuth_deg = 30.0

Steps are applied in the order of the file. Unknown names and parameters are refused with the nearest known
one. Recipes that ship are files of this folder, and go by their name.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, ValidationError

from analysis.recipes.average import Average, PoleAverage, Sides
from analysis.recipes.specular import AlignPeak, SpecularGrid
from analysis.recipes.steps import (
    AngleCut,
    Blank,
    Cosine,
    FloorShift,
    Given,
    KnownRepeatability,
    Reference,
    Scale,
    ShadowCut,
    Step,
)
from rig.errors import BadInput
from rig.parts import Part
from rig.rig_errors import explain, nearest

if TYPE_CHECKING:
    from analysis.recipes.readings import Readings

STEPS: dict[str, type[Step]] = {
    kind.model_fields["name"].annotation.__args__[0]: kind  # type: ignore[union-attr]
    for kind in (
        Blank, FloorShift, ShadowCut, AngleCut, AlignPeak, Average, PoleAverage, Sides, SpecularGrid,
        KnownRepeatability, Reference, Scale, Cosine,
    )
}  # fmt: skip
"""Every step by the name that a recipe's file uses."""

AnyStep = Annotated[
    Blank | FloorShift | ShadowCut | AngleCut | AlignPeak | Average | PoleAverage | Sides | SpecularGrid
    | KnownRepeatability | Reference | Scale | Cosine,
    Field(discriminator="name"),
]  # fmt: skip

ALIGN, GRID = "align_peak", "specular_grid"

FOLDER = Path(__file__).parent
LARGEST_BYTES = 1_000_000


class Recipe(Part):
    """A chain of steps."""

    title: str = Field(min_length=1, description="what the recipe makes of what, in one line")
    source: str = Field("", description="whose chain this is, and how it is known")
    reads: str = Field("", description="name of the only format that it is meant for; empty: any")
    step: tuple[AnyStep, ...] = Field(min_length=1, description="at least one [[step]]")

    def apply(self, readings: Readings, given: Given) -> Readings:
        """Apply the steps in their order.

        Parameters
        ----------
        readings : Readings
            Of one file, or of several of one sample together.
        given : Given
            The blank, where there is one.

        Raises
        ------
        BadInput
            If a step cannot be done with what is given.
        """
        for step in self.step:
            readings = step.apply(readings, given)
        return readings

    def history(self) -> tuple[str, ...]:
        """Describe the steps with all their parameters, one line each."""
        return tuple(
            " ".join([step.name, *(f"{key}={_plain(value)}" for key, value in _parameters(step).items())])
            for step in self.step
        )


def shipped() -> tuple[str, ...]:
    """Names of the recipes that ship."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load(name: str) -> Recipe:
    """Read a recipe: one that ships by its name, else a TOML file by its path.

    Raises
    ------
    BadInput
        If there is none, or the file does not say what a recipe says; names the field.
    """
    known = shipped()
    path = FOLDER / f"{name}.toml" if name in known else Path(name)
    if not path.is_file():
        if path.suffix == ".toml" or path.parent != Path():
            raise BadInput("no such file", where=name, todo="check the path of the recipe")
        raise BadInput(
            f"no recipe '{name}' ships", where="--recipe", todo=f"use one that does{nearest(name, known)}"
        )
    if path.stat().st_size > LARGEST_BYTES:
        raise BadInput("is too large for a recipe", where=str(path), todo="check the path")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"is not TOML: {error}", where=str(path), todo="correct it there") from error
    return parsed(content, str(path))


def parsed(content: dict[str, Any], where: str) -> Recipe:
    """Check what a recipe's file says.

    Raises
    ------
    BadInput
        At the first thing that is wrong.
    """
    steps = content.get("step")
    for index, step in enumerate(steps if isinstance(steps, list) else []):
        name = step.get("name") if isinstance(step, dict) else None
        if not isinstance(name, str) or name not in STEPS:
            what = (
                f"step[{index}] has no name" if name is None else f"step[{index}].name = '{name}' is no step"
            )
            raise BadInput(what, where=where, todo=f"use a known name{nearest(str(name), STEPS)}")
    _require_use_of_alignment(steps if isinstance(steps, list) else [], where)
    try:
        # TOML has lists, the recipe tuples: strict types, but JSON's rules for containers.
        return Recipe.model_validate_json(_as_json(content))
    except ValidationError as error:
        raise explain(error, content, Recipe, where) from error


def _require_use_of_alignment(steps: list[dict[str, Any]], where: str) -> None:
    """Refuse an alignment that nothing takes out of the directions."""
    names = [step["name"] for step in steps]
    if ALIGN in names and GRID not in names[names.index(ALIGN) :]:
        raise BadInput(
            f"{ALIGN} finds a shift, and no {GRID} after it takes it out",
            where=where,
            todo=f"add the step {GRID}, or leave {ALIGN} out",
        )


def _as_json(content: dict[str, Any]) -> str:
    import json

    return json.dumps(content, default=str)


def _parameters(step: Step) -> dict[str, Any]:
    return {key: value for key, value in step.model_dump().items() if key != "name"}


def _plain(value: Any) -> str:
    if isinstance(value, tuple | list):
        return "[" + ",".join(_plain(one) for one in value) + "]"
    return (
        f"{value:g}"
        if isinstance(value, float)
        else str(value).lower()
        if isinstance(value, bool)
        else str(value)
    )
