"""Writes `docs/light.md` from what `gonio bench light --json --plots docs/light` printed.

    gonio bench light --json --plots docs/light > numbers.json
    python -m benchmarks.light_page docs numbers.json [MORE.json ...]

A file named after a part, what `gonio bench PART --json` printed, takes that part's place.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.rows import gathered, sections
from simulator.light.methods import METHODS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_HEAD = """# The twin's light: error against time

Written by `python -m benchmarks.light_page docs numbers.json` from what `gonio bench light --json --plots
docs/light` printed. Errors are RMS over the sample's pixels relative to their mean radiance. Times are
processor times, of all threads together, on two cores that other programs shared: trust ratios, whose sides
took turns. How methods are chosen, and what they leave out, is in
[decision 5](decisions/0005-light-methods.md); what is computed for a scene of yours, and how much each kind
of light is, is told by

    gonio sim --explain --material cook-torrance:kd=0.3,ks=0.5,m=0.2,ior=1.5 --housing-albedo 0.04
    gonio sim --stray --material lambert:kd=0.05 --housing-albedo 0.04

and what the twin itself computes is set by `gonio sim --housing-albedo A --tolerance T`. How far numbers hold
at the ends of all scales is in [stability](stability.md).
"""

_TITLES: dict[str, tuple[str, str, tuple[str, str] | None]] = {
    "light_chooser": (
        "The choice of methods",
        "Scenes drawn from a seed: every kind of material, lamps from points to half the sample, housings, "
        "mirrors, grazing poses. Each is rendered as it is decided and in every other way that might be "
        "quicker, and held against direct light in float64, images of the lamp, and converged renders.",
        ("light_chooser.png", "Every way to compute each scene, and the chosen one in a ring"),
    ),
    "light_methods": (
        "Every method",
        "Scenes that need different methods, each by every method that can, at several tolerances. What of "
        "the light is not a method's own is computed as the choice would.",
        ("light_methods.png", "Error against time of every method, scene by scene; the chosen ones in rings"),
    ),
    "light_direct": (
        "Direct light",
        "Lamps, pixels and pupils with sizes, by quadrature, against Mitsuba's `direct` at 16 independent "
        "samples per pixel. Truth is float64's closed form, as a mean over nodes where something has a size.",
        ("light_direct.png", "Quadrature, and Mitsuba's direct"),
    ),
    "light_housing": (
        "Stray light of a housing",
        "Light that the walls (albedo 4 %) throw on the sample, mean over the sample: radiosity, and path "
        "tracing to a depth of 8.",
        ("light_housing.png", "Radiosity and path tracing"),
    ),
    "light_mirror": (
        "A mirror beside the sample",
        "Light that a planar mirror throws on the sample: an image of the lamp, against the closed form.",
        None,
    ),
    "light_caustics": (
        "Light gathered by a hollow mirror",
        "The photon map against rays followed one by one, and, in planar mirrors, against the lamp's image.",
        None,
    ),
    "light_demo": (
        "The demo",
        "Its three materials at poses of its machine, as the twin renders them, against path tracing given "
        "the time that it needs for the same error.",
        None,
    ),
    "light_modes": ("Both modes of Mitsuba", "Z-tests in Mitsuba's manner, pixel by pixel.", None),
    "light_bsdfs": (
        "Models in single precision",
        "Every registered BSDF against its closed form in float64: the largest relative error over random, "
        "grazing, peak and degenerate directions and over the box of shapes.",
        None,
    ),
}
_NEAREST = 5
"""Rows of each part that are named where the page tells what is nearest to its target."""


def page(results: Sequence[dict[str, Any]]) -> str:
    """Set rows of `gonio bench` as a page."""
    first, *rest = sections(results, _TITLES, "light")
    return "\n".join([*_methods(), first, "", *_worst(results), *rest])


def _methods() -> Iterator[str]:
    yield _HEAD
    yield "| method | light paths that it can compute |"
    yield "| --- | --- |"
    for method in METHODS:
        expression = str(method.covers).replace("|", "\\|")
        yield f"| {method.name} | `{expression}` |"
    yield ""


def _worst(results: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Name what missed its target, then what came nearest to it, part by part."""
    yield "## Worst cases\n"
    yield "Of each part, the rows that miss their targets, or are nearest to them.\n"
    yield "| what | value | target | of what is allowed |"
    yield "| --- | --- | --- | --- |"
    for part in _TITLES:
        own = [each for each in results if each["name"].startswith(f"{part}: ") and each["target"]]
        own.sort(key=_used, reverse=True)
        missed = sum(not each["ok"] for each in own)
        for each in own[: max(_NEAREST, missed)]:
            name = str(each["name"]).replace("|", "\\|")
            verdict = f"{100.0 * _used(each):.0f} %" + ("" if each["ok"] else ", **missed**")
            yield f"| {name} | {_number(each['value'])} {each['unit']} | {each['target']:g} | {verdict} |"
    yield ""


def _used(row: dict[str, Any]) -> float:
    """Return the part of what a target allows that a value uses up; above 1 for one that is missed."""
    value, target = row["value"], row["target"]
    if value is None:
        return float("inf")
    # A row does not tell which way its target counts; whether it is met does.
    at_least = (value > target) == row["ok"]
    return float(target / value if at_least else value / target) if value else 0.0


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def main() -> int:
    """Write the page into a folder."""
    if len(sys.argv) < 3:
        print(__doc__)
        return 2
    results = gathered([Path(path) for path in sys.argv[2:]], _TITLES)
    (Path(sys.argv[1]) / "light.md").write_text(page(results), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
