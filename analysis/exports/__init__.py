"""Fitted models for renderers: Mitsuba's XML or dictionary, and metallic-roughness as glTF or MaterialX.

Each export returns an `Exported`, which says what was written and how far it is from the model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from analysis.exports.exported import Exported, Reflects

SUFFIXES = (".xml", ".json", ".gltf", ".mtlx")


def check_name(path: Path) -> None:
    """Refuse a name that no export is written under.

    Raises
    ------
    BadInput
        If the name ends in none of `SUFFIXES`, or its folder is not there.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(
            f"no fit is exported as '{path.suffix}'",
            where=str(path),
            todo=f"end the name in {', '.join(SUFFIXES)}",
        )
    if not path.absolute().parent.is_dir():
        raise BadInput("no such folder", where=str(path.parent), todo="make it, or choose another place")


def export(model: Reflects, path: Path, *, name: str, channels: Sequence[str]) -> Exported:
    """Write a model for a renderer, in the form that the name's end asks for.

    Parameters
    ----------
    model : Reflects
        The model with its parameters: of `analysis.models`, or a factored one.
    path : Path
        `.xml` or `.json` for Mitsuba, `.gltf` or `.mtlx` for the nearest metallic-roughness material.
    name : str
        The model's name.
    channels : sequence of str
        Names of the model's channels: one, R, G, B, or X, Y, Z, or wavelengths such as `550 nm`.

    Raises
    ------
    BadInput
        If the name ends otherwise, the channels are no colour, or the form cannot hold the model.
    """
    from analysis.exports import metallic_roughness, mitsuba_material
    from analysis.models.base import Model

    check_name(path)
    isotropic = not isinstance(model, Model) or model.ISOTROPIC
    if path.suffix.lower() in {".xml", ".json"}:
        return mitsuba_material.write(model, path, name, channels, isotropic=isotropic)
    if not isotropic:
        raise BadInput(
            f"is not isotropic, which no {path.suffix} of gonio's holds",
            where=name,
            todo="export it as .xml or .json for Mitsuba, or fit an isotropic model",
        )
    return metallic_roughness.write(model, path, name, channels)
