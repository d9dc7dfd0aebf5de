"""What `gonio merge --inspect` prints for a person."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.inspection import FrameFacts, Inspection

_FILES_NAMED = 3


def print_inspection(found: Inspection) -> None:
    """Print facts of each file, then what all show together, then what to know."""
    for fact in found.frames:
        _print_facts(fact)
    print(f"clip level measured, DN: {_levels(found.clip_dn, 'nothing clips')}")
    if not found.findings:
        print("nothing speaks against these files")
    for finding in found.findings:
        named = ", ".join(finding.files[:_FILES_NAMED])
        more = len(finding.files) - _FILES_NAMED
        print(f"- {finding.what}: {named}{f' and {more} more' if more > 0 else ''}; {finding.todo}")


def _print_facts(fact: FrameFacts) -> None:
    print(fact.path)
    camera = f"{fact.camera or 'unknown camera'}, serial {fact.serial or 'not stated'}"
    print(f"  {camera}, {fact.width_px} x {fact.height_px}, {_filters(fact.cfa)}")
    settings = [
        _stated("ISO", fact.iso),
        _stated("time", fact.exposure_s, " s"),
        _stated("f", fact.f_number),
        "white balance " + ("not stated" if fact.white_balance is None else _levels(fact.white_balance)),
    ]
    print(f"  {', '.join(settings)}")
    covered = _levels(fact.optical_black_dn or ())
    of_covered = f"covered pixels read {covered} DN" if covered else "no covered pixels"
    print(f"  black taken as {_levels(fact.black_dn)} DN, {of_covered}")
    shown = _levels(fact.clip_dn)
    of_clip = f"shows at {shown} DN" if shown else "does not show"
    print(f"  clip level taken as {fact.white_dn:g} DN, {of_clip}, highest count {fact.highest_dn}")
    print(f"  {fact.bits} bits in use, in steps of {fact.step_dn}")


def _filters(cfa: Sequence[str]) -> str:
    """Colours row by row; one name where no colour filter is stated."""
    return cfa[0] if len(set(cfa)) == 1 else " ".join(cfa)


def _stated(name: str, value: float | None, unit: str = "") -> str:
    return f"{name} not stated" if value is None else f"{name} {value:.6g}{unit}"


def _levels(values: Sequence[float | None], none: str = "") -> str:
    """Numbers by position; one where all are the same."""
    if not any(value is not None for value in values):
        return none
    texts = ["-" if value is None else f"{value:.5g}" for value in values]
    return texts[0] if len(set(texts)) == 1 else " ".join(texts)
