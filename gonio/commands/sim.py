"""Start the twin: servos and lamp on pseudo-terminals, a hot folder where frames arrive, until Ctrl-C."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, Any

from gonio.output import add_json_option, print_json
from rig.errors import Refused

if TYPE_CHECKING:
    import argparse

EXAMPLE = "gonio sim --speed 10 --station sample1=cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"

_EXIT_BY_SIGNAL = 128


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    from simulator.options import add_twin_options

    add_twin_options(parser)
    audit = parser.add_argument_group("asking about the twin's light, instead of starting it")
    audit.add_argument(
        "--explain", action="store_true", help="which light paths are computed, how, or skipped"
    )
    audit.add_argument("--stray", action="store_true", help="share of every kind of light path, per pose")
    audit.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="MATERIAL",
        help="a sample to ask about (default: lambert:kd=0.5); may be repeated",
    )
    audit.add_argument(
        "--mirror",
        action="append",
        default=[],
        metavar="MIRROR",
        help="a mirror beside the sample, such as planar:centre_mm=0/80/60,across_mm=50/0/0,up_mm=0/20/40 or "
        "spherical:vertex_mm=-96/0/72,facing=0.8/0/-0.6,radius_mm=120,rim_mm=50,reflectance=0.9; may be "
        "repeated (default: twin.mirrors of the rig file)",
    )
    audit.add_argument(
        "--poses", type=int, default=4, metavar="N", help="how many poses, drawn by --seed (default: 4)"
    )
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Serve until a signal comes: 130 after Ctrl-C, 143 after SIGTERM."""
    if options.explain or options.stray:
        from gonio.light_text import audit

        return audit(options)
    if sys.platform != "linux":
        raise Refused("the twin needs Linux's pseudo-terminals", where="gonio sim", todo="run it on Linux")
    from simulator.options import settings_from
    from simulator.server import serve

    ended_by = serve(settings_from(options), print_json if options.json else _print_ports)
    return _EXIT_BY_SIGNAL + (ended_by or signal.SIGTERM)


def _print_ports(ready: dict[str, Any]) -> None:
    ids = ", ".join(map(str, ready["ids"]))
    print(f"servos  {ready['servos']}  {ready['baud']} baud, any works; ids {ids}")
    print(f"lamp    {ready['lamp']}  115200 baud, lines of text")
    print(f"frames  {ready['frames']}")
    print(f"rig     {ready['rig']}")
    print(f"Try: gonio rig check --rig {ready['rig']}        Stop with Ctrl-C.", flush=True)
