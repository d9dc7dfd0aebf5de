"""The options that describe a twin, for `gonio sim` and `python -m simulator`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

_MOST_FLAWED = 45.0
"""Degrees of play, or ticks of error: no servo is as bad."""


@dataclass(frozen=True)
class TwinSettings:
    """What a twin is started with.

    Parameters
    ----------
    materials : dict of str to str
        Material by station; the others hold what the light process gives them.
    seed : int
        Decides sub-tick offsets, noise, and the truth about the white.
    speed : float
        How many times faster than the clock motion and exposures run.
    rig : str or None
        Rig file of the machine to be; None for the default machine.
    folder : str or None
        Where everything is put and stays; None for a folder that goes with the twin.
    log : bool
        Whether to keep a log of the wires.
    variant : str or None
        Mitsuba's variant, None to choose.
    housing_albedo : float, optional
        Of the walls around the machine; 0 is black, None what the rig file says.
    tolerance : float, optional
        Error of the light that is allowed, relative to the mean radiance over the sample; None what the rig
        file says.
    commands : int or None
        A descriptor: the twin ends with its other end, and each line on it flushes the log and is answered on
        standard output.
    faults : str or None
        Script of faults, see `simulator.faults`; None for a machine that is well.
    backlash_deg : float
        Play of every servo between its encoder and the arm, degrees; see `simulator.shaft.Flaws`.
    steady_error_ticks : float
        How far from its goal friction leaves every servo; see `simulator.shaft.Flaws`.
    """

    materials: dict[str, str] = field(default_factory=dict)
    seed: int = 0
    speed: float = 1.0
    rig: str | None = None
    folder: str | None = None
    log: bool = True
    variant: str | None = None
    housing_albedo: float | None = None
    tolerance: float | None = None
    commands: int | None = None
    faults: str | None = None
    backlash_deg: float = 0.0
    steady_error_ticks: float = 0.0


def add_twin_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe a twin."""
    parser.add_argument("--seed", type=int, default=0, help="decides noise and every hidden truth")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="K", help="motion and exposures run K times faster"
    )
    parser.add_argument("--folder", metavar="DIR", help="where to put everything; kept (default: temporary)")
    parser.add_argument("--rig", metavar="FILE", help="a rig.toml to imitate (default: the default machine)")
    parser.add_argument(
        "--station",
        action="append",
        default=[],
        metavar="NAME=MATERIAL",
        help="what a station holds, such as sample1=lambert:kd=0.5; may be repeated",
    )
    parser.add_argument(
        "--variant", help="Mitsuba's variant, scalar or llvm (default: the fastest that works)"
    )
    parser.add_argument(
        "--housing-albedo",
        type=float,
        metavar="A",
        help="of the walls, 0 for black (default: twin.housing_albedo of the rig file)",
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        metavar="T",
        help="relative error of the light that is allowed (default: twin.tolerance of the rig file)",
    )
    parser.add_argument(
        "--backlash-deg",
        type=float,
        default=0.0,
        metavar="DEG",
        help="play of every servo, which its encoder does not see (a real one: 0.25; default: 0)",
    )
    parser.add_argument(
        "--steady-error-ticks",
        type=float,
        default=0.0,
        metavar="N",
        help="how far from their goals servos stay at their usual gain (a real one: 4; default: 0)",
    )
    parser.add_argument("--faults", metavar="FILE", help="what fails and when (docs/faults.md)")
    parser.add_argument("--no-log", action="store_true", help="keep no log of the wires")


def check_light(options: argparse.Namespace) -> None:
    """Refuse an albedo or a tolerance that is none.

    Raises
    ------
    BadInput
        Says which.
    """
    if options.tolerance is not None and not 0.0 < options.tolerance < 1.0:
        what = f"a tolerance of {options.tolerance:g}"
        raise BadInput(what, where="--tolerance", todo="give one between 0 and 1")
    if options.housing_albedo is not None and not 0.0 <= options.housing_albedo < 1.0:
        what = f"a housing of albedo {options.housing_albedo:g}"
        raise BadInput(what, where="--housing-albedo", todo="give an albedo from 0, below 1")


def settings_from(options: argparse.Namespace, *, commands: int | None = None) -> TwinSettings:
    """Turn options into settings.

    Raises
    ------
    BadInput
        A station without a material; an albedo, a tolerance or a servo's flaw that is none.
    """
    check_light(options)
    for option in ("backlash_deg", "steady_error_ticks"):
        value = getattr(options, option)
        if not 0.0 <= value < _MOST_FLAWED:
            where = f"--{option.replace('_', '-')}"
            raise BadInput(f"{value:g}", where=where, todo=f"give a number from 0, below {_MOST_FLAWED:g}")
    materials = {}
    for station in options.station:
        name, separator, material = station.partition("=")
        if not (name and separator and material):
            raise BadInput(f"cannot read {station!r}", where="--station", todo="write NAME=MATERIAL")
        materials[name] = material
    return TwinSettings(
        materials=materials,
        seed=options.seed,
        speed=options.speed,
        rig=options.rig,
        folder=options.folder,
        log=not options.no_log,
        variant=options.variant,
        housing_albedo=options.housing_albedo,
        tolerance=options.tolerance,
        commands=commands,
        faults=options.faults,
        backlash_deg=options.backlash_deg,
        steady_error_ticks=options.steady_error_ticks,
    )
