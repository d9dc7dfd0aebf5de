"""Reduce a session to BRDF samples with uncertainty: ratio to its white, geometry of every pixel.

SESSION is the folder that `gonio capture` made. Each pose's frames are merged; blocks of pixels become
samples; samples.nc is written into the session, replacing an earlier one.

The JSON object: session, out, poses, samples, channels, dropped: {reason: values}, pixels: {flag: pixels}
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gonio.output import Progress, add_json_option, print_json
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

    from rig.description import Rig

EXAMPLE = "gonio reduce sessions/blue-paint"

DEFAULT_BIN_PX = 8
DEFAULT_MAX_THETA_DEG = 85.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("session", metavar="SESSION", help="folder of a session")
    parser.add_argument(
        "--bin-px",
        type=int,
        default=DEFAULT_BIN_PX,
        metavar="N",
        help="edge of the square bins, an even number of pixels (default: 8)",
    )
    parser.add_argument(
        "--max-theta-deg",
        type=float,
        default=DEFAULT_MAX_THETA_DEG,
        metavar="T",
        help="leave out pixels lit or seen from beyond this angle (default: 85)",
    )
    parser.add_argument(
        "--out", metavar="FILE", help="write there, .nc or .csv (default: samples.nc in the session)"
    )
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Reduce, write, and say what was kept and what was not."""
    if options.bin_px < 2 or options.bin_px % 2:
        raise BadInput(
            f"{options.bin_px} pixels cannot hold whole colour quads",
            where="--bin-px",
            todo="give an even number, 2 or more",
        )
    if not 0 < options.max_theta_deg < 90:
        raise BadInput(f"{options.max_theta_deg:g} is not between 0 and 90", where="--max-theta-deg")
    from analysis.formats import require_writer
    from analysis.measurement import Options
    from analysis.reduce import reduce_session
    from analysis.samples import write
    from capture.session import Session

    chosen = Options(bin_px=options.bin_px, max_theta_deg=options.max_theta_deg)
    out = Path(options.out) if options.out else Path(options.session) / "samples.nc"
    with Session.open(Path(options.session)) as session:
        require_writer(out)  # before the work, not after it
        _require_bins(options.bin_px, session.rig)
        progress = Progress("poses", len(session.poses("sample")))
        samples = reduce_session(session, options=chosen, progress=progress)
    write(samples, out)
    counts = {
        group: {
            name.removeprefix(f"{group}_"): int(value)
            for name, value in samples.attrs.items()
            if name.startswith(f"{group}_")
        }
        for group in ("dropped", "pixels")
    }
    result = {
        "session": options.session,
        "out": str(out),
        "poses": len(set(samples["pose"].to_numpy().tolist())),
        "samples": int(samples.sizes["sample"]),
        "channels": [str(name) for name in samples["channel"].to_numpy()],
        **counts,
    }
    if options.json:
        print_json(result)
        return 0
    channels = len(samples["channel"])
    print(f"{result['samples']} samples in {channels} channels from {result['poses']} poses: {out}")
    for group, title in (("dropped", "channel values dropped"), ("pixels", "pixels flagged")):
        listed = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in counts[group].items() if n)
        print(f"{title}: {listed or 'none'}")
    return 0


def _require_bins(bin_px: int, rig: Rig) -> None:
    most = min(rig.camera.width_px, rig.camera.height_px)
    if bin_px > most:
        raise BadInput(
            f"bins of {bin_px} pixels do not fit into the frames",
            where="--bin-px",
            todo=f"give {most // 2 * 2} or less",
        )
