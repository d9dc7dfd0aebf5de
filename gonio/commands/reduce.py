"""Reduce to BRDF samples with uncertainty: a session, or raw files of another instrument by a recipe.

A session is the folder that `gonio capture` made: ratio to its white, geometry of every pixel. Each pose's
frames are merged; blocks of pixels become samples; samples.nc is written into the session, replacing an
earlier one. Rejections of samples (gonio check --reject) in the file that is replaced are kept; where their
samples are not found again, nothing is written.

With --recipe, the raw files of one sample are reduced by named steps: NAME is a recipe that ships, or a TOML
file of your own (docs/recipes.md lists the steps). Several files are repeats of the sample: where the recipe
averages them, their repeatability is told, and no uncertainty is stated below it. Recipes that ship:
  rt300s         every direction of an RT-300S scan, negatives kept
  rt300s-fred    the published FRED tables (legacy: floor shifted to zero)
  rt300s-zemax   the published Zemax tables (legacy: floor shifted to zero)
  mwir-published the published formula of the mid-infrared tables, with the cosine that should not be there

Corrections, each with a column of the uncertainty; --without NAME leaves one out, and states its whole effect
as uncertainty instead. The samples record what was left out (option_without).
  flat-field       u_flat        lens, vignetting, pixels: the white divides pixel by pixel; else by its mean
  stray-light      u_stray       the light trap's pictures are subtracted, where the plan asked for them
  lamp-drift       u_lamp        the lamp's light between white and sample, by its photodiode
  lens-distortion  u_distortion  the rig file's lens model gives each pixel its direction
  linearity        u_linearity   the sensor's bent response, where its calibration has found one

The JSON object: session, out, without, poses, samples, channels, dropped: {reason: values},
pixels: {flag: pixels}; with --recipe: files, blank, recipe, steps, out, samples, flagged, repeatability,
notes, loss, doubts
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.output import Progress, add_json_option, caution, print_json, say
from gonio.overwriting import add_drop_option, keep_rejections, require_place
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

    from analysis.recipes.repeatability import Repeatability
    from rig.description import Rig

EXAMPLE = (
    "gonio reduce sessions/blue-paint\n"
    "  gonio reduce coating.xls --blank blank.xls --recipe rt300s --out coating.nc"
)

DEFAULT_BIN_PX = 8
DEFAULT_MAX_THETA_DEG = 85.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "inputs", nargs="+", metavar="SESSION", help="folder of a session; with --recipe one or more FILEs"
    )
    parser.add_argument(
        "--bin-px",
        type=int,
        metavar="N",
        help=f"session: edge of the square bins, an even number of pixels (default: {DEFAULT_BIN_PX})",
    )
    parser.add_argument(
        "--max-theta-deg",
        type=float,
        metavar="T",
        help=f"session: leave out pixels lit or seen from beyond it (default: {DEFAULT_MAX_THETA_DEG:g})",
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="NAME[,NAME]",
        help="session: leave corrections out, their errors in the uncertainty: flat-field, stray-light, "
        "lamp-drift, linearity (above)",
    )
    parser.add_argument("--recipe", metavar="NAME|FILE", help="reduce raw files by the steps of a recipe")
    parser.add_argument("--blank", metavar="FILE", help="recipe: the measurement without a sample")
    parser.add_argument("--material", metavar="NAME", help="recipe: which of several in an in-plane table")
    parser.add_argument(
        "--out",
        "-o",
        metavar="FILE",
        help="write there, in the format of its suffix (default: samples.nc in the session)",
    )
    add_drop_option(parser)
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Reduce, write, and say what was kept and what was not."""
    if options.recipe is not None:
        return _by_recipe(options)
    for name in ("blank", "material"):
        if getattr(options, name) is not None:
            raise BadInput(
                "means nothing to a session", where=f"--{name}", todo="leave it out, or give --recipe"
            )
    if len(options.inputs) > 1:
        raise BadInput(
            "one session at a time", where=options.inputs[1], todo="for files of a sample give --recipe"
        )
    return _session(options)


def _by_recipe(options: argparse.Namespace) -> int:
    for name in ("bin_px", "max_theta_deg"):
        if getattr(options, name) is not None:
            raise BadInput(
                "means nothing to a recipe",
                where="--" + name.replace("_", "-"),
                todo="leave it out; the step angle_cut leaves out angles",
            )
    if options.without:
        raise BadInput("means nothing to a recipe", where="--without", todo="leave out the step instead")
    if options.out is None:
        raise BadInput("no file to write to", where="--out", todo="give one, such as --out samples.nc")
    from analysis.formats import require_writer
    from analysis.recipes import reduce_files
    from analysis.recipes.recipe import load
    from analysis.samples import write

    out = Path(options.out)
    require_writer(out)  # before the work, not after it
    require_place(out, options)
    recipe = load(options.recipe)
    reduced = reduce_files(options.inputs, recipe, blank=options.blank, material=options.material)
    doubts = caution(options.recipe, reduced.samples.attrs)
    samples = keep_rejections(reduced.samples, out, options)
    loss = write(samples, out)
    flagged = int((samples["flags"].to_numpy() != 0).sum())
    result = {
        "files": options.inputs,
        "blank": options.blank,
        "recipe": recipe.title,
        "steps": list(recipe.history()),
        "out": str(out),
        "samples": int(samples.sizes["sample"]),
        "flagged": flagged,
        "repeatability": _described(reduced.repeatability),
        "notes": list(reduced.notes),
        "loss": str(loss),
        "doubts": doubts,
    }
    if options.json:
        print_json(result)
        return 0
    for note in reduced.notes:
        say(f"note: {note}")
    print(f"{result['samples']} samples, {flagged} values flagged: {out}")
    for step in recipe.history():
        print(f"  {step}")
    if reduced.repeatability is not None:
        _print_repeatability(reduced.repeatability)
    print(f"written: {loss}")
    return 0


def _described(found: Repeatability | None) -> dict[str, Any] | None:
    if found is None:
        return None
    from dataclasses import asdict

    return asdict(found)


def _print_repeatability(found: Repeatability) -> None:
    print(
        f"repeatability of one file, from {found.files} files in {found.cells} places: "
        f"{100 * found.relative:.2g} % of the reading and {found.additive:.2g} "
        f"({found.dof} degrees of freedom); it is the floor of u_f_r"
    )
    for band in found.bands:
        unit = "deg" if band.quantity == "theta_o_deg" else ""
        name = band.quantity.removesuffix("_deg")
        print(
            f"  {name:<8} {band.low:8.4g} to {band.high:8.4g} {unit:<4} {100 * band.relative:5.2g} %"
            f"  ({band.dof} degrees of freedom)"
        )


def _session(options: argparse.Namespace) -> int:
    given = options.inputs[0]
    bin_px = DEFAULT_BIN_PX if options.bin_px is None else options.bin_px
    max_theta_deg = DEFAULT_MAX_THETA_DEG if options.max_theta_deg is None else options.max_theta_deg
    if bin_px < 2 or bin_px % 2:
        raise BadInput(
            f"{bin_px} pixels cannot hold whole colour quads",
            where="--bin-px",
            todo="give an even number, 2 or more",
        )
    if not 0 < max_theta_deg < 90:
        raise BadInput(f"{max_theta_deg:g} is not between 0 and 90", where="--max-theta-deg")
    if Path(given).is_file():
        raise BadInput(
            "is a file, not a session",
            where=given,
            todo="give --recipe NAME to reduce a raw file of readings",
        )
    from analysis.corrections import corrections_named
    from analysis.formats import require_writer
    from analysis.measurement import Options
    from analysis.reduce import reduce_session
    from analysis.samples import write
    from capture.session import Session

    without = corrections_named(options.without)
    chosen = Options(bin_px=bin_px, max_theta_deg=max_theta_deg, without=without)
    out = Path(options.out) if options.out else Path(given) / "samples.nc"
    with Session.open(Path(given)) as session:
        require_writer(out)  # before the work, not after it
        require_place(out, options)
        _require_bins(bin_px, session.rig)
        progress = Progress("poses", len(session.poses("sample")))
        for name in (edited := session.edited_files()):
            say(f"note: {name} was edited after the capture; it is used as it is now")
        samples = reduce_session(session, options=chosen, progress=progress)
    if edited:
        samples.attrs["edited_after_capture"] = ", ".join(edited)
    samples = keep_rejections(samples, out, options)
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
        "session": given,
        "out": str(out),
        "without": [str(correction) for correction in without],
        "poses": len(set(samples["pose"].to_numpy().tolist())),
        "samples": int(samples.sizes["sample"]),
        "channels": [str(name) for name in samples["channel"].to_numpy()],
        **counts,
    }
    if options.json:
        print_json(result)
        return 0
    channels = len(samples["channel"])
    if without:
        say(f"note: not corrected: {', '.join(without)}")
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
