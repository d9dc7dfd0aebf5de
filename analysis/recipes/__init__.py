"""Reduction recipes: the measurement equation as named steps, so that a published chain can be repeated.

`reduce_files` is the whole way: readings of one or more files of a sample, the blank, a recipe, samples.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from analysis.formats.doubts import ATTRIBUTE
from analysis.recipes.readings import joined, read_readings, to_samples
from analysis.recipes.recipe import Recipe, load
from analysis.recipes.steps import Given
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

    from analysis.recipes.repeatability import Repeatability


class Reduced(NamedTuple):
    """What a recipe made of files.

    Attributes
    ----------
    samples : xarray.Dataset
        Its attributes `recipe`, `recipe_source`, `recipe_files` and `recipe_steps` say how, `doubts` why a
        file may be cut short or damaged.
    repeatability : Repeatability or None
        Where several files were averaged.
    notes : tuple of str
        What the steps have to tell the person.
    """

    samples: xr.Dataset
    repeatability: Repeatability | None
    notes: tuple[str, ...]


def reduce_files(
    files: Sequence[str | Path],
    recipe: Recipe | str,
    *,
    blank: str | Path | None = None,
    material: str | None = None,
) -> Reduced:
    """Reduce raw files of one sample with a recipe.

    Parameters
    ----------
    files : sequence of path
        One measurement each; several are repeats of one sample.
    recipe : Recipe or str
        A recipe, the name of one that ships, or the path of its file.
    blank : path, optional
        The measurement without a sample.
    material : str, optional
        Which one, of a table that holds several.

    Raises
    ------
    BadInput
        If a file cannot be read, is not what the recipe reads, or a step cannot be done.
    """
    chosen = load(recipe) if isinstance(recipe, str) else recipe
    parts = [read_readings(Path(file), only=chosen.reads, material=material) for file in files]
    if not parts:
        raise BadInput("no file to reduce", where="recipe", todo="name at least one")
    empty = None if blank is None else read_readings(Path(blank), only=chosen.reads)
    if empty is not None and not any(step.name == "blank" for step in chosen.step):
        raise BadInput(
            "the recipe has no step that takes a blank",
            where=str(blank),
            todo="leave it out, or add the step",
        )
    done = chosen.apply(joined(parts), Given(blank=empty))
    named = [Path(file).name for file in files]
    subtracted = "" if blank is None else f" less {Path(blank).name}"
    samples = to_samples(done, source=", ".join(named) + subtracted)
    samples.attrs |= {
        "recipe": chosen.title,
        "recipe_source": chosen.source,
        "recipe_files": ", ".join(named) + subtracted,
        "recipe_steps": "; ".join(chosen.history()),
    }
    read = [*zip(named, parts, strict=True), *([(Path(blank).name, empty)] if blank and empty else [])]
    found = [f"{name}: {part.doubts}" for name, part in read if part.doubts]
    if found:
        samples.attrs[ATTRIBUTE] = "; ".join(found)
    return Reduced(samples, done.repeatability, done.notes)
