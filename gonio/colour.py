"""`gonio calibrate colour`: a camera's colours from a picture of a chart."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.output import print_json, say
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from analysis.colour_calibration import ChartColours, ColourCalibration
    from analysis.colour_chart import ChartReading, Picture

    Array = NDArray[np.float64]

PAGE_FILE = "report.html"
DEFAULT_LAMP = "colour:D65"
_LARGE_DELTA_E = 5.0
_UNEVEN = 0.1
_CLOSE = 0.05


def add_colour_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gonio calibrate colour`."""
    parser.add_argument("files", nargs="+", type=Path, metavar="MERGE", help=".npz of gonio merge --out")
    parser.add_argument(
        "--bands-nm", default="", metavar="NM,NM,NM", help="the band of each file, where there are three"
    )
    parser.add_argument(
        "--corners", nargs=4, metavar="X,Y", help="corners of the field of patches, in pixels, around it"
    )
    parser.add_argument(
        "--lamp",
        default=DEFAULT_LAMP,
        metavar="SPECTRUM",
        help=f"colours are meant under it: a table, or colour:NAME (default: {DEFAULT_LAMP})",
    )
    parser.add_argument("--sensitivities", metavar="SPECTRUM", help="of the camera's channels")
    parser.add_argument("--lit-by", metavar="SPECTRUM", help="the lamp of the picture (with --sensitivities)")
    parser.add_argument(
        "--rig", type=Path, default=Path("rig.toml"), metavar="FILE", help="default: rig.toml"
    )


def calibrate_colour(options: argparse.Namespace) -> int:
    """Calibrate: 0 when the calibration is written.

    Raises
    ------
    BadInput
        An option or a file is wrong, or no chart is found.
    """
    from analysis.colour_calibration import (
        COLOUR_FILE,
        VISIBLE_NM,
        ColourCalibration,
        colours_of,
        reference_reflectance,
        save_colour,
    )
    from analysis.colour_chart import read_chart
    from analysis.colour_page import write_colour_page
    from analysis.spectra import read_spectrum

    bands_nm = wavelengths(options.bands_nm, "--bands-nm")
    lamp = read_spectrum(options.lamp)
    picture, channels = _picture(options.files, bands_nm)
    names, reflectance = reference_reflectance(VISIBLE_NM)
    response = _response(options, bands_nm, VISIBLE_NM, picture.values.shape[2])
    expected = reflectance @ response
    reading = read_chart(picture, expected, _corners(options.corners))
    colours = colours_of(reading, expected, reflectance, lamp)
    chosen = colours.matrix
    calibration = ColourCalibration(
        channels,
        chosen.matrix,
        colours.white_xyz,
        options.lamp,
        float(chosen.left_out.mean()),
        float(chosen.left_out.max()),
        datetime.now(UTC).isoformat(timespec="seconds"),
    )
    doubts = _doubts(calibration, colours)
    facts = _facts(calibration, colours, reading, names)
    if options.sensitivities:
        facts["spectral"] = _spectral(colours, reflectance, response, VISIBLE_NM)
    calibrations = options.out or options.rig.parent / "calibration"
    folder = calibrations / f"colour-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    folder.mkdir(parents=True, exist_ok=True)
    write_colour_page(folder / PAGE_FILE, calibration, colours, reading, names=names, doubts=doubts)
    save_colour(calibration, colours.fits, calibrations / COLOUR_FILE)
    facts |= {
        "calibration": str(calibrations / COLOUR_FILE),
        "page": str(folder / PAGE_FILE),
        "doubts": doubts,
    }
    _tell(options, facts)
    return 0


def wavelengths(text: str, where: str) -> tuple[float, ...]:
    """Read wavelengths separated by commas.

    Raises
    ------
    BadInput
        A word that is no positive number.
    """
    try:
        values = tuple(float(word) for word in text.split(",") if word.strip())
    except ValueError:
        values = (math.nan,)
    if not all(math.isfinite(value) and value > 0.0 for value in values):
        todo = "write it such as 600,540,460"
        raise BadInput(f"cannot read {text!r}", where=where, todo=todo)
    return values


def _picture(paths: list[Path], bands_nm: tuple[float, ...]) -> tuple[Picture, tuple[str, ...]]:
    """Put merges together to a picture of three channels."""
    import numpy as np

    from analysis.colour_chart import Picture, picture_of
    from capture.merge import Flag
    from capture.radiance import read_radiance

    bad = int(Flag.OVER_RANGE | Flag.HOT)
    merges = [read_radiance(path) for path in paths]
    if len(paths) == 1:
        if bands_nm:
            raise BadInput(
                "one file has no bands", where="--bands-nm", todo="give three files, or leave it out"
            )
        one = merges[0]
        names = tuple(one.channels)
        return picture_of(one.radiance, one.flags, one.cfa, len(names), bad), names
    if len(paths) != 3 or len(bands_nm) != 3:
        what = f"{len(paths)} files and {len(bands_nm)} bands"
        raise BadInput(what, where="gonio calibrate colour", todo="give one file, or three with --bands-nm")
    sizes = {merge.radiance.shape for merge in merges}
    if len(sizes) != 1:
        raise BadInput("files of several sizes", where=str(paths[1]), todo="give pictures of one scene")
    # A band lights all sites of a colour filter array alike but for a factor: they count together.
    whole = [
        picture_of(merge.radiance, merge.flags, np.zeros((2, 2), dtype=np.int64), 1, bad) for merge in merges
    ]
    values, usable = (
        np.concatenate([getattr(each, name) for each in whole], axis=-1) for name in ("values", "usable")
    )
    return Picture(values, usable, whole[0].px), tuple(f"{nm:g} nm" for nm in bands_nm)


def _response(options: argparse.Namespace, bands_nm: tuple[float, ...], nm: Array, channels: int) -> Array:
    """Weigh wavelengths for each channel, each column's sum 1."""
    import numpy as np

    from analysis.colour_calibration import typical_response
    from analysis.spectra import read_spectrum

    if options.sensitivities:
        if not options.lit_by:
            todo = "give --lit-by SPECTRUM, the lamp of the picture"
            raise BadInput("sensitivities without a lamp", where="--sensitivities", todo=todo)
        response = read_spectrum(options.sensitivities).at(nm) * read_spectrum(options.lit_by).at(nm)[:, :1]
        if response.shape[1] != channels:
            what = f"{response.shape[1]} sensitivities for {channels} channels"
            raise BadInput(
                what, where=options.sensitivities, todo="give one for each channel, in their order"
            )
        sums = response.sum(axis=0)
        if np.any(sums <= 0.0):
            raise BadInput("no light in a channel", where=options.sensitivities, todo="see --lit-by")
        return np.asarray(response / sums)
    return typical_response(nm, bands_nm)


def _corners(given: list[str] | None) -> list[tuple[float, float]] | None:
    if given is None:
        return None
    corners = []
    for text in given:
        words = text.split(",")
        try:
            x, y = (float(word) for word in words)
        except ValueError:
            raise BadInput(f"cannot read {text!r}", where="--corners", todo="write X,Y four times") from None
        corners.append((x, y))
    return corners


def _doubts(calibration: ColourCalibration, colours: ChartColours) -> list[str]:
    import numpy as np

    doubts = []
    if calibration.delta_e_mean > _LARGE_DELTA_E:
        doubts.append(
            f"left-out patches are {calibration.delta_e_mean:.1f} off on the mean (CIEDE2000): "
            "the bands are far from an eye's, or the light is"
        )
    uneven = float(np.abs(colours.slopes).max())
    if uneven > _UNEVEN:
        doubts.append(
            f"the light changes by {100.0 * uneven:.0f} % over the chart; an even slope was taken off"
        )
    best = colours.fits[0]
    if best.degree > 1:
        doubts.append(
            f"a root polynomial of degree {best.degree} does better on single colours "
            f"({best.left_out.mean():.2f}); sums of lights need the matrix"
        )
    return doubts


def _facts(
    calibration: ColourCalibration, colours: ChartColours, reading: ChartReading, names: list[str]
) -> dict[str, Any]:
    return {
        "channels": list(calibration.channels),
        "order": reading.order,
        "agreement": reading.agreement,
        "matrix": calibration.matrix.tolist(),
        "white_xyz": calibration.white_xyz.tolist(),
        "fits": [
            {
                "degree": fit.degree,
                "delta_e_left_out": [float(value) for value in fit.left_out],
                "delta_e_mean": float(fit.left_out.mean()),
                "delta_e_max": float(fit.left_out.max()),
            }
            for fit in colours.fits
        ],
        "patches": [
            {"name": name, "values": values.tolist(), "u": u.tolist(), "centre_px": centre.tolist()}
            for name, values, u, centre in zip(
                names, colours.values, colours.u_values, reading.centres_px, strict=True
            )
        ],
    }


def _spectral(colours: ChartColours, reflectance: Array, response: Array, nm: Array) -> dict[str, float]:
    """How far patches are from what the camera should read, and how well their spectra tell their colours."""
    import numpy as np

    from analysis.appearance import ciede2000
    from analysis.colour_calibration import spectral_estimate
    from analysis.colour_fit import lab, xyz_of_spectra
    from analysis.spectra import read_spectrum

    apart = np.abs(colours.values / (reflectance @ response) - 1.0)
    estimate, _ = spectral_estimate(colours.values, colours.u_values, response, nm)
    lamp = read_spectrum(DEFAULT_LAMP).at(nm)[:, 0]
    white = xyz_of_spectra(nm, np.ones((1, nm.size)), lamp)[0]
    pair = [lab(xyz_of_spectra(nm, each, lamp), white) for each in (estimate, reflectance)]
    difference = ciede2000(*pair)
    return {
        "median_apart": float(np.median(apart)),
        "largest_apart": float(apart.max()),
        "delta_e_mean": float(difference.mean()),
        "delta_e_max": float(difference.max()),
    }


def _tell(options: argparse.Namespace, facts: dict[str, Any]) -> None:
    if options.json:
        print_json(facts)
        return
    print(f"chart                {facts['order']}, agreement with its reference {facts['agreement']:.3f}")
    for fit in sorted(facts["fits"], key=lambda each: each["degree"]):
        name = "matrix" if fit["degree"] == 1 else f"root polynomial {fit['degree']}"
        print(
            f"{name:<20} CIEDE2000 of left-out patches "
            f"{fit['delta_e_mean']:.2f}, at most {fit['delta_e_max']:.2f}"
        )
    if "spectral" in facts:
        spectral = facts["spectral"]
        print(f"from sensitivities   channels apart by {100.0 * spectral['median_apart']:.1f} % (median)")
        print(
            f"spectral estimate    CIEDE2000 {spectral['delta_e_mean']:.2f}, "
            f"at most {spectral['delta_e_max']:.2f}"
        )
    print(f"{facts['calibration']}    page: {facts['page']}")
    for doubt in facts["doubts"]:
        say(f"gonio calibrate: {doubt}")
