"""`python -m simulator`: the twin's process, for programs; people start `gonio sim`."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from rig.errors import BadInput, GonioError
from simulator.light_process import error_record
from simulator.server import TwinSettings, serve


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
    parser.add_argument("--no-log", action="store_true", help="keep no log of the wires")


def settings_from(options: argparse.Namespace, *, commands: int | None = None) -> TwinSettings:
    """Turn options into settings.

    Raises
    ------
    BadInput
        A station without a material.
    """
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
        commands=commands,
    )


def _say(record: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(record) + "\n")
    sys.stdout.flush()


def main() -> int:
    """Serve until standard input ends or a signal comes; a line of JSON says that it is ready, or why not."""
    parser = argparse.ArgumentParser(prog="python -m simulator", description=__doc__)
    add_twin_options(parser)
    try:
        serve(settings_from(parser.parse_args(), commands=sys.stdin.fileno()), _say)
    except GonioError as error:
        _say({"error": error_record(error)})
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
