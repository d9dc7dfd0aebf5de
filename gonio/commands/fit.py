"""Fit reflectance models to BRDF samples of any laboratory: parameters with uncertainty, goodness of fit.

FILE is a session's folder or a file in any format of docs/formats.md; its content tells which. Without
--model the six usual models are fitted, with --all every model and the factored one, whose distribution and
reflectance are tables. They are ranked by cross-validation: the residual, in the loss's own measure, at
incidences that were left out of the fit; where there is one incidence, by BIC. With --compare several files
are set side by side. Without --wavelength-nm all channels of a file share the shape parameters; kd and ks are
each channel's own. docs/fit.md explains the tables, the pictures and the JSON object.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from gonio.format_options import add_format_options, format_options
from gonio.output import Progress, add_json_option, at_work, caution, print_json, say
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    import xarray as xr

    from analysis.comparison import Candidate
    from analysis.differences import Difference

EXAMPLE = "gonio fit garnet_red.brdf --wavelength-nm 550 --model cook-torrance"

MOST_APERTURE_DEG = 90.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `gonio fit`."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="samples to fit")
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--model",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="models to fit (default: the six usual ones, ranked)",
    )
    which.add_argument("--all", action="store_true", help="fit every model there is")
    parser.add_argument(
        "--wavelength-nm",
        nargs="+",
        type=float,
        action="extend",
        metavar="W",
        help="channels to fit together",
    )
    parser.add_argument(
        "--loss",
        metavar="NAME",
        help="chi2, log, cbrt, l2 or robust (default: chi2 where uncertainties exist, else log)",
    )
    parser.add_argument(
        "--shape",
        metavar="HOW",
        default="shared",
        help="shared: channels share widths and the like; per-channel: each has its own (default: shared)",
    )
    parser.add_argument(
        "--max-theta-deg", type=float, metavar="T", help="leave out samples beyond this angle"
    )
    parser.add_argument(
        "--aperture-deg",
        nargs=2,
        type=float,
        metavar=("LIGHT", "CAMERA"),
        help="full angles of light and camera aperture as seen from the sample, in place of the file's own; "
        "the fit takes them out of narrow lobes; 0 0: takes nothing out",
    )
    parser.add_argument("--compare", action="store_true", help="set each parameter of all files side by side")
    parser.add_argument("--plots", metavar="FOLDER", help="write a picture of each fit there")
    parser.add_argument(
        "--export",
        metavar="OUT",
        help="write the best fit of the file for renderers, and say how near that is: .xml or .json for "
        "Mitsuba, .gltf or .mtlx for the nearest metallic-roughness material",
    )
    add_format_options(parser)
    add_json_option(parser)


@dataclass(frozen=True)
class _Fitted:
    """What came of one file; `masked` by candidate."""

    file: str
    channels: list[str]
    ranked: list[Candidate]
    masked: list[dict[str, int]]
    left_out: dict[str, str] = field(default_factory=dict)
    doubts: str = ""


def run(options: argparse.Namespace) -> int:
    """Fit and print; see the module's description."""
    from analysis.models import DEFAULT_MODELS
    from analysis.ranking import FITTED
    from gonio.fit_text import page

    names = list(dict.fromkeys(options.model or (FITTED if options.all else DEFAULT_MODELS)))
    _check_names(names)
    if options.compare and len(options.files) < 2:
        raise BadInput("there is one file", where="--compare", todo="name the files to compare")
    if options.export:
        _check_export(options)
    progress = Progress("fits", len(options.files) * len(names))
    fitted = []
    for file in options.files:
        fitted.append(_fit(file, names, options, progress))
        if not options.json and not options.compare:
            print(page(file, fitted[-1].channels, fitted[-1].ranked, masked=fitted[-1].masked[0],
                       left_out=fitted[-1].left_out))  # fmt: skip
    compared = _compared(fitted) if options.compare else {}
    exported = _export(options.export, fitted[0]) if options.export else {}
    if options.json:
        print_json(_object(fitted, compared, with_comparison=options.compare) | exported)
    elif options.compare:
        from gonio.fit_text import side_by_side

        print(side_by_side(options.files, fitted[0].channels, compared))
    if options.plots:
        _draw(options.plots, fitted)
    return 0


def _check_export(options: argparse.Namespace) -> None:
    """Refuse before anything is read."""
    from pathlib import Path

    from analysis.exports import check_name

    if len(options.files) > 1:
        raise BadInput(
            f"{len(options.files)} files, one can be exported", where="--export", todo="name one file"
        )
    check_name(Path(options.export))


def _export(out: str, fitted: _Fitted) -> dict[str, Any]:
    """Write the best fit for renderers, say what that loses, and return it for the JSON object."""
    from pathlib import Path

    from analysis.exports import export

    best = fitted.ranked[0]
    with at_work(f"writing {out}"):
        written = export(best.result.model, Path(out), name=best.name, channels=fitted.channels)
    say(f"{best.name} to {written}")
    return {"export": {"model": best.name, **asdict(written)}}


def _check_names(names: Sequence[str]) -> None:
    """Refuse before anything is read."""
    from pathlib import Path

    from analysis.ranking import FITTED, check_names

    for name in names:
        if name not in FITTED and Path(name).exists():
            raise BadInput(
                f"'{name}' is a file and no model", where="--model", todo="write the files before --model"
            )
    try:
        check_names(names)
    except BadInput as error:
        raise BadInput(str(error), where="--model") from None


def _fit(file: str, names: Sequence[str], options: argparse.Namespace, progress: Progress) -> _Fitted:
    """Read a file, fit and judge each model."""
    from analysis.ranking import rank
    from analysis.samples import read, select
    from analysis.units import require_degrees
    from gonio.fit_entry import masked

    given = read(file, **format_options(options))
    doubts = caution(file, given.attrs)
    whole = select(given, wavelength_nm=options.wavelength_nm, where=file)
    require_degrees(whole, file)
    if options.aperture_deg:
        whole = _seen_through(whole, options.aperture_deg)
    samples = select(whole, max_theta_deg=options.max_theta_deg, where=file)
    left_out: dict[str, str] = {}
    try:
        ranked = rank(
            samples,
            names,
            told=lambda name: progress(note=name),
            # Whoever asks for all takes what there is; a model that was named must be fitted.
            left_out=left_out if options.all else None,
            **_engine_options(options),
        )
    except BadInput as error:
        raise BadInput(str(error), where=file) from None
    channels = [str(channel) for channel in samples["channel"].to_numpy()]
    left = [masked(whole, samples, one.result) for one in ranked]
    return _Fitted(file, channels, ranked, left, left_out, doubts)


def _seen_through(samples: xr.Dataset, aperture_deg: Sequence[float]) -> xr.Dataset:
    """Give samples other solid angles of light and camera."""
    import math

    if not all(0.0 <= full < MOST_APERTURE_DEG for full in aperture_deg):
        raise BadInput(
            f"{aperture_deg[0]:g} and {aperture_deg[1]:g} are no full angles of light and camera",
            where="--aperture-deg",
            todo=f"give degrees from 0 to {MOST_APERTURE_DEG:g}",
        )
    light_sr, camera_sr = (2.0 * math.pi * (1.0 - math.cos(math.radians(0.5 * a))) for a in aperture_deg)
    return samples.assign_attrs(source_solid_angle_sr=light_sr, receiver_solid_angle_sr=camera_sr)


def _engine_options(options: argparse.Namespace) -> dict[str, Any]:
    """Collect what is handed on to the fit itself."""
    return {"loss": options.loss, "shape": options.shape}


def _object(
    fitted: Sequence[_Fitted], compared: dict[str, list[Difference]], *, with_comparison: bool
) -> dict[str, Any]:
    from analysis.comparison import in_words
    from gonio.fit_entry import comparison, entry

    return {
        "fits": [
            entry(each.file, each.channels, one, left)
            for each in fitted
            for one, left in zip(each.ranked, each.masked, strict=True)
        ],
        "words": {each.file: in_words(each.ranked) for each in fitted},
        "left_out": {each.file: each.left_out for each in fitted},
        "doubts": {each.file: each.doubts for each in fitted},
        **(
            {"comparison": [row for model, rows in compared.items() for row in comparison(model, rows)]}
            if with_comparison
            else {}
        ),
    }


def _compared(fitted: Sequence[_Fitted]) -> dict[str, list[Difference]]:
    """Compare the files model by model; models in the order of the first file's ranking."""
    from analysis.differences import differences

    counts = {len(each.channels) for each in fitted}
    if len(counts) > 1:
        raise BadInput(
            "the files have different numbers of channels",
            where="--compare",
            todo="choose some with --wavelength-nm",
        )
    by_name = [{one.name: one.result for one in each.ranked} for each in fitted]
    everywhere = [name for name in by_name[0] if all(name in each for each in by_name)]
    return {name: differences([each[name] for each in by_name]) for name in everywhere}


def _draw(folder: str, fitted: Sequence[_Fitted]) -> None:
    from pathlib import Path

    from analysis.fit_figures import draw

    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    stems = [Path(each.file).resolve().stem for each in fitted]
    progress = Progress("pictures", sum(len(each.ranked) for each in fitted))
    for number, (each, stem) in enumerate(zip(fitted, stems, strict=True), start=1):
        name = stem if stems.count(stem) == 1 else f"{number}-{stem}"
        for one in each.ranked:
            draw(place / f"{name}-{one.name}.png", one, each.channels, title=name)
            progress(note=one.name)
    say(f"pictures: {place}")
