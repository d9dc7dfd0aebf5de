"""Which light paths a scene can have, and the cheapest method that covers them: decided before rendering.

Both what a scene can have and what a method covers are sets of light paths (`simulator.light.paths`); a
method will do when every path of the scene's is one of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from rig.errors import Refused
from simulator.light.paths import LightPaths


class Method(StrEnum):
    """How radiance is computed, cheapest first."""

    BLACK = "black"
    CLOSED_FORM = "closed form at pixel centres"
    PIXEL_CENTRES = "pixel centres through Mitsuba"
    PIXEL_BY_PIXEL = "one BSDF value per pixel"
    PATH = "path tracing"


@dataclass(frozen=True)
class SceneFacts:
    """What decides about the light paths of a scene with one flat sample and a small lamp.

    Parameters
    ----------
    scatters : bool
        The sample has a part that scatters into all directions: D.
    mirrors : bool
        It has a part that reflects as a mirror does: S.
    closed_form : bool
        Its f_r is a model of `analysis.models`.
    housing_albedo : float
        Albedo of the housing; 0 is black surroundings.
    """

    scatters: bool
    mirrors: bool = False
    closed_form: bool = False
    housing_albedo: float = 0.0

    @property
    def expression(self) -> str:
        """Light paths that reach the camera; empty where there are none.

        A flat sample does not light itself, and the camera does not see the lamp: in black surroundings light
        meets the sample once. A housing scatters to it, and back, any number of times.
        """
        letters = "D" * self.scatters + "S" * self.mirrors
        if not letters:
            return ""
        last = letters if len(letters) == 1 else "(D|S)"
        if self.housing_albedo == 0.0:
            return f"L{last}E"
        return "LD+E" if last == "D" else f"L(D|S)*{last}E"


@dataclass(frozen=True)
class Ability:
    """What a method covers and where it runs.

    Parameters
    ----------
    covers : str
        Expression of the light paths that it computes.
    error : str
        How far its pixels may be from the truth.
    scalar, vector : bool
        Whether it is worth its while in the scalar variant, and in the LLVM variant.
    any_material : bool
        Whether it needs no closed form.
    """

    covers: str
    error: str
    scalar: bool = True
    vector: bool = True
    any_material: bool = True


ABILITIES: dict[Method, Ability] = {
    Method.BLACK: Ability("", "none"),
    Method.CLOSED_FORM: Ability("LDE", "1e-12 relative", vector=False, any_material=False),
    Method.PIXEL_CENTRES: Ability("LDE", "1e-6 relative (RMS)", scalar=False),
    Method.PIXEL_BY_PIXEL: Ability("LDE", "1e-6 relative (RMS)", vector=False),
    Method.PATH: Ability("L(D|S)+E", "noise of its samples"),
}


@dataclass(frozen=True)
class Decision:
    """What was decided, in words that can be shown.

    Attributes
    ----------
    expression : str
        Light paths of the scene.
    method : Method
        The cheapest method that covers them.
    error : str
        How far its pixels may be from the truth.
    """

    expression: str
    method: Method
    error: str


def choose_method(facts: SceneFacts, *, vector: bool) -> Decision:
    """Choose the cheapest method that covers every light path of a scene.

    Parameters
    ----------
    facts : SceneFacts
        The scene.
    vector : bool
        Whether Mitsuba runs vectorised (LLVM).

    Returns
    -------
    Decision

    Raises
    ------
    Refused
        No method covers the scene.
    """
    needed = LightPaths(facts.expression)
    for method, ability in ABILITIES.items():
        runs = ability.vector if vector else ability.scalar
        knows = ability.any_material or facts.closed_form
        if runs and knows and needed <= LightPaths(ability.covers):
            return Decision(facts.expression, method, ability.error)
    raise Refused(f"no method covers the light paths {facts.expression}", todo="simplify the scene")
