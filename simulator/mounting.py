"""How a sample is made and mounted: its form, its tilt, its relief, a pattern on it; words of a line.

Parts follow the material, each after an `@`:

@turned:deg=30                           turned about its normal, from +x towards +y, as a grain is
@tilted:x_deg=0.4,y_deg=-0.2             mounted askew: turned about its own +x, then about +y
@raised:mm=0.5                           above the plane in which the axes meet; below 0: too low
@sphere:radius_mm=15                     a ball; its apex is at the centre
@cylinder:radius_mm=15,axis_deg=0        a rod; its axis lies level, so far from +x
@rough:slope_rms=0.02,wavelength_mm=2,seed=1   an uneven surface, such as orange peel
@checker:side_mm=4,kd=0.1                every other square has these parameters; a corner at the centre
@gradient:kd=0.1,along_deg=0             from the material's own parameters at one edge to these at the other
@image:file=leaf.png,kd=0.1              a picture: black is the material's own, white has these

Everything reaches as far as the sample's disc, seen along the normal; beyond it is black. The pattern, too,
lies on the sample as if projected along the normal. In between, a gradient or picture is a mixture of the
two materials, f_r = (1 - w) f_own + w f_other, as of dots too fine to be seen.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rig.errors import BadInput
from simulator.line_words import hint, number, pairs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from simulator.materials import Material

    Array = NDArray[np.float64]

    Other = Callable[[Mapping[str, str]], Material]

_PART = re.compile(r"@(?=[a-z]+:)")
MOST_TILT_RAD = math.radians(45.0)
STEEPEST = 0.5
"""Slope (RMS) up to which a relief without shadows of its own is worth computing."""
LARGEST_SEED = 2**32 - 1


class Form(StrEnum):
    """Of the sample; all are convex, so that no part of it lights another."""

    FLAT = "flat"
    SPHERE = "sphere"
    CYLINDER = "cylinder"


class PatternKind(StrEnum):
    """How two materials share the sample."""

    CHECKER = "checker"
    GRADIENT = "gradient"
    IMAGE = "image"


@dataclass(frozen=True)
class Relief:
    """An uneven surface: a sum of waves in all directions, of lengths from 0.7 to 1.4 times the mean.

    It turns normals and moves no point; no part of it hides or shadows another. Of a Gaussian surface 2.4e-4
    would be hidden where slope_rms tan(theta) is 0.5, and 2.5 % where it is 1 (Smith 1967): towards grazing
    this is an approximation.

    Parameters
    ----------
    slope_rms : float
        Root of the mean squared gradient.
    wavelength_mm : float
        Typical length of a wave.
    seed : int
        Decides which waves.
    """

    slope_rms: float
    wavelength_mm: float
    seed: int


@dataclass(frozen=True)
class Pattern:
    """A second material on parts of the sample.

    Parameters
    ----------
    kind : PatternKind
    other : Material
        The second one.
    side_mm : float
        Of a checker's squares.
    along_rad : float
        Where a gradient goes to, from +x towards +y.
    file : str
        The picture: 8 or 16 bits per channel, linear (full scale is 1), or floats from 0 to 1; stretched over
        the square around the sample, its right at +x and its top at +y.
    """

    kind: PatternKind
    other: Material = field(hash=False)
    side_mm: float = 1.0
    along_rad: float = 0.0
    file: str = ""


@dataclass(frozen=True)
class Mounting:
    """How a sample is made and mounted; by default flat, level and alike everywhere.

    Parameters
    ----------
    form : Form
    radius_mm : float
        Of sphere and cylinder.
    axis_rad : float
        Of the cylinder, from +x towards +y.
    turn_rad : float
        Of the material's own axes about the normal.
    tilt_x_rad, tilt_y_rad : float
        About the sample's own +x, then about the machine's +y.
    height_mm : float
        Of the apex.
    relief : Relief, optional
    pattern : Pattern, optional
    """

    form: Form = Form.FLAT
    radius_mm: float = math.inf
    axis_rad: float = 0.0
    turn_rad: float = 0.0
    tilt_x_rad: float = 0.0
    tilt_y_rad: float = 0.0
    height_mm: float = 0.0
    relief: Relief | None = None
    pattern: Pattern | None = None

    @property
    def rotation(self) -> Array:
        """Rotation (3, 3) that takes the sample's own coordinates to the scene's."""
        (cx, sx), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in (self.tilt_x_rad, self.tilt_y_rad))
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
        about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
        return np.asarray(about_y @ about_x)

    @property
    def to_scene(self) -> Array:
        """That rotation, then the shift of the apex, shape (4, 4)."""
        placed = np.eye(4)
        placed[:3, :3], placed[2, 3] = self.rotation, self.height_mm
        return placed


PLAIN = Mounting()
"""Flat, level, alike everywhere."""


def split_parts(spec: str) -> tuple[str, list[tuple[str, dict[str, str]]]]:
    """Split a station's line into the material and the parts after it.

    Returns
    -------
    material : str
    parts : list of (str, dict of str to str)
        Name and pairs of each.

    Raises
    ------
    BadInput
        A part that is unknown or comes twice.
    """
    material, *texts = _PART.split(spec)
    parts: dict[str, dict[str, str]] = {}
    for text in texts:
        name, _, rest = text.partition(":")
        if name not in _KNOWN:
            raise BadInput(f"there is no @{name}", where=spec, todo=hint(name, _KNOWN))
        if name in parts:
            raise BadInput(f"@{name} is given twice", where=spec, todo="give it once")
        parts[name] = pairs(spec, rest)
    return material, list(parts.items())


def mounting_of(spec: str, parts: list[tuple[str, dict[str, str]]], other: Other) -> Mounting:
    """Read the parts of a line.

    Parameters
    ----------
    spec : str
        The whole line, for errors.
    parts : list of (str, dict of str to str)
        As `split_parts` returns them.
    other : callable
        Makes a pattern's second material of the pairs that change the first.

    Raises
    ------
    BadInput
        A missing, unknown or impossible value, two forms, or two patterns.
    """
    mounting = PLAIN
    for name, given in parts:
        words = _Words(spec, name, dict(given))
        if name in set(Form) and mounting.form is not Form.FLAT:
            raise BadInput("two forms", where=spec, todo="give one")
        if name in set(PatternKind):
            if mounting.pattern is not None:
                raise BadInput("two patterns", where=spec, todo="give one")
            mounting = replace(mounting, pattern=_pattern(words, PatternKind(name), other))
        else:
            mounting = _PARTS[name](words, mounting)
        words.end()
    return mounting


class _Words:
    """Pairs of one part, taken one by one."""

    def __init__(self, spec: str, part: str, given: dict[str, str]) -> None:
        self.spec, self._part, self._left = spec, part, given
        self._known: list[str] = []

    def number(
        self, key: str, default: float | None = None, *, above: float = -math.inf, most: float = math.inf
    ) -> float:
        """Take a number; without a default it has to be there."""
        text = self.text(key, None if default is None else repr(default))
        value = number(self.spec, key, text)
        if not above < value <= most:
            limits = [f"above {above:g}"] * math.isfinite(above) + [f"at most {most:g}"] * math.isfinite(most)
            raise self.error(f"{key}={text} is impossible", f"give one {' and '.join(limits)}")
        return value

    def angle(self, key: str, default: float | None = 0.0, *, most_rad: float = math.tau) -> float:
        """Take an angle in degrees, and return it in radians."""
        value = math.radians(self.number(key, default))
        if abs(value) > most_rad:
            raise self.error(f"{key} is too large", f"give one within {math.degrees(most_rad):g} degrees")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """Take a word."""
        self._known.append(key)
        if key in self._left:
            return self._left.pop(key)
        if default is None:
            raise self.error(f"@{self._part} needs {key}", f"write @{self._part}:{key}=...")
        return default

    def rest(self) -> dict[str, str]:
        """Take all that is left."""
        rest, self._left = self._left, {}
        return rest

    def end(self) -> None:
        """Refuse what nobody took."""
        for key in self._left:
            raise self.error(f"@{self._part} has no {key}", hint(key, self._known))

    def error(self, what: str, todo: str) -> BadInput:
        """Return what is wrong with the line."""
        return BadInput(what, where=self.spec, todo=todo)


def _turned(words: _Words, mounting: Mounting) -> Mounting:
    return replace(mounting, turn_rad=words.angle("deg", None))


def _tilted(words: _Words, mounting: Mounting) -> Mounting:
    x_rad, y_rad = (words.angle(key, most_rad=MOST_TILT_RAD) for key in ("x_deg", "y_deg"))
    return replace(mounting, tilt_x_rad=x_rad, tilt_y_rad=y_rad)


def _raised(words: _Words, mounting: Mounting) -> Mounting:
    return replace(mounting, height_mm=words.number("mm"))


def _sphere(words: _Words, mounting: Mounting) -> Mounting:
    return replace(mounting, form=Form.SPHERE, radius_mm=words.number("radius_mm", above=0.0))


def _cylinder(words: _Words, mounting: Mounting) -> Mounting:
    radius_mm = words.number("radius_mm", above=0.0)
    return replace(mounting, form=Form.CYLINDER, radius_mm=radius_mm, axis_rad=words.angle("axis_deg"))


def _rough(words: _Words, mounting: Mounting) -> Mounting:
    seed = words.number("seed", 0.0, above=-1.0, most=LARGEST_SEED)
    if seed != int(seed):
        raise words.error("seed is no whole number", "give a whole number")
    slope_rms = words.number("slope_rms", above=0.0, most=STEEPEST)
    return replace(mounting, relief=Relief(slope_rms, words.number("wavelength_mm", above=0.0), int(seed)))


_PARTS: dict[str, Callable[[_Words, Mounting], Mounting]] = {
    "turned": _turned,
    "tilted": _tilted,
    "raised": _raised,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "rough": _rough,
}
_KNOWN = (*_PARTS, *PatternKind)


def _pattern(words: _Words, kind: PatternKind, other: Other) -> Pattern:
    side_mm, along_rad, file = 1.0, 0.0, ""
    if kind is PatternKind.CHECKER:
        side_mm = words.number("side_mm", above=0.0)
    elif kind is PatternKind.GRADIENT:
        along_rad = words.angle("along_deg")
    else:
        file = words.text("file")
        if not Path(file).is_file():
            raise words.error(f"there is no file {file}", "give the path of a picture")
    changed = words.rest()
    if not changed:
        raise words.error(f"@{kind} changes nothing", f"write for example @{kind}:kd=0.1")
    return Pattern(kind, other(changed), side_mm, along_rad, file)
