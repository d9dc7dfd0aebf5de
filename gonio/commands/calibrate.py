"""Calibrate parts of the machine: its sensor, its white, its colours.

sensor  bias, dark current, hot pixels, gain and read noise (photon transfer), linearity, clip level of each
        channel, from frames of the white and of the dark that the machine shoots itself, or from a folder of
        frames (--frames-from): darks are files that say so themselves, or with "dark" in their own or their
        folder's name; all others are flats, two or more of each exposure, up to beyond clipping
white   the plate's certificate (--certificate: lines of nm, 8 deg/hemispherical reflectance, standard
        uncertainty) and measured reflectance factors (--points: lines of source zenith and azimuth, view
        zenith and azimuth, factors), which narrow its shape; without a calibration the shape is a generic
        one with a large uncertainty
colour  a ColorChecker in merged pictures (.npz of gonio merge): one of a colour camera, or three of one
        camera in three bands (--bands-nm). The chart is found, or given by --corners; a matrix to XYZ is
        fitted, and root polynomials beside it, judged by patches that were left out. With --sensitivities and
        --lit-by patches are also compared with what the camera should read, and their spectra estimated

The result replaces calibration/sensor.toml, white.toml or colour.toml beside the rig file. Of a sensor,
frames, maps, data sheet (JSON) and a page stay in a dated folder there, of colours the page. A frame of
another camera or ISO, or a dark frame with light in it, is named, and nothing is replaced.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.colour import add_colour_options, calibrate_colour, wavelengths
from gonio.commands.rig import add_rig_options, load_rig_options
from gonio.mounting import add_mounted_option, machine_wishes, mounted_roles
from gonio.output import add_json_option, at_work, print_json, say
from rig.errors import BadInput, GonioError

if TYPE_CHECKING:
    import argparse

    from capture.characterise import SensorCharacter
    from capture.sensor_shots import ShotFrames
    from rig.description import Rig

EXAMPLE = "gonio calibrate sensor --rig rig.toml"

PAGE_FILE = "report.html"
ROLES = ("white",)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="sensor|white|colour")
    text = "gain, noise, clip level, linearity, hot pixels"
    sensor = actions.add_parser("sensor", help=text, description=text)
    add_rig_options(sensor)
    sensor.add_argument(
        "--frames-from", type=Path, metavar="FOLDER", help="use these frames instead of shooting any"
    )
    add_mounted_option(sensor, ROLES)
    text = "certificate and shape of the white reference"
    white = actions.add_parser("white", help=text, description=text)
    white.add_argument("--rig", type=Path, default=Path("rig.toml"), metavar="FILE", help="default: rig.toml")
    white.add_argument(
        "--certificate", type=Path, metavar="FILE", help="table of nm, reflectance, uncertainty"
    )
    white.add_argument("--points", type=Path, metavar="FILE", help="table of reflectance factors")
    white.add_argument(
        "--points-nm", type=float, metavar="NM", help="band of the points (default: their mean)"
    )
    white.add_argument(
        "--channel-nm",
        default="",
        metavar="NM,NM,NM",
        help="effective wavelength of each channel; without, the certificate's mean over 400 to 700 nm",
    )
    white.add_argument("--name", metavar="TEXT", help="the plate's name")
    text = "matrix from the camera's channels to XYZ, from a picture of a chart"
    colour = actions.add_parser("colour", help=text, description=text)
    add_colour_options(colour)
    for action in (sensor, white, colour):
        action.add_argument(
            "--out",
            type=Path,
            metavar="FOLDER",
            help="calibration folder; default: calibration beside the rig file",
        )
        add_json_option(action)


def run(options: argparse.Namespace) -> int:
    """Calibrate: 0 when the calibration is written, else as for every command; 130 after Ctrl-C."""
    return {"white": _white, "sensor": _sensor, "colour": calibrate_colour}[options.action](options)


def _white(options: argparse.Namespace) -> int:
    """Write the white's calibration from the files of its laboratory."""
    import numpy as np

    from analysis.white_calibration import WHITE_FILE, WhiteCalibration, save_white
    from analysis.white_files import read_certificate, read_points
    from analysis.white_shape import PtfeShape

    if options.certificate is None and options.points is None:
        todo = "give --certificate FILE, --points FILE, or both"
        raise BadInput("nothing to calibrate the white with", where="gonio calibrate white", todo=todo)
    calibration = WhiteCalibration(
        certificate=read_certificate(options.certificate) if options.certificate else None,
        points=read_points(options.points, options.points_nm) if options.points else None,
        channel_nm=wavelengths(options.channel_nm, "--channel-nm"),
        name=options.name,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    if calibration.certificate is not None:
        values, u_values = calibration.of_channels(max(len(calibration.channel_nm), 1))
    else:
        values = u_values = np.empty(0)
    points = calibration.points
    shape = PtfeShape.generic()
    if points is not None:
        shape = PtfeShape.fitted(points.wi, points.wo, points.factor, points.u_relative)
    folder = options.out or options.rig.parent / "calibration"
    folder.mkdir(parents=True, exist_ok=True)
    save_white(calibration, folder / WHITE_FILE)
    normal, slanted = np.array([0.0, 0.0, 1.0]), np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5)])
    facts: dict[str, Any] = {
        "calibration": str(folder / WHITE_FILE),
        "rho": values.tolist(),
        "u_rho": u_values.tolist(),
        "points": 0 if points is None else len(points.factor),
        "factor_45_0": float(shape.factor(slanted, normal)),
        "u_factor_45_0": float(shape.factor(slanted, normal) * shape.u_relative(slanted, normal)),
    }
    if options.json:
        print_json(facts)
        return 0
    for rho, u_rho in zip(facts["rho"], facts["u_rho"], strict=True):
        print(f"8 deg/hemispherical reflectance  {rho:.4f} ± {u_rho:.2g}")
    shown = f"{facts['factor_45_0']:.4f} ± {facts['u_factor_45_0']:.2g}"
    print(f"45/0 factor over it              {shown}, from {facts['points']} points")
    print(facts["calibration"])
    return 0


def _sensor(options: argparse.Namespace) -> int:
    given = options.frames_from is not None
    rig = None if given and not options.rig.is_file() else load_rig_options(options)
    calibration = options.out or (rig.folder if rig is not None else Path()) / "calibration"
    folder = calibration / f"sensor-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    if given or rig is None:
        return _finish(options, options.frames_from, rig, folder)
    shot, exit_code = _shoot(options, rig, folder)
    if shot is None or not shot.complete:
        say(f"gonio calibrate: ended early; {calibration / 'sensor.toml'} is as it was")
        return exit_code if exit_code is not None else 3
    return _finish(options, folder, rig, folder, lamp_temperature_deg_c=shot.lamp_temperature_deg_c)


def _shoot(options: argparse.Namespace, rig: Rig, folder: Path) -> tuple[ShotFrames | None, int | None]:
    from capture.sensor_shots import shoot_sensor
    from gonio.signals import StopRequests

    mounted = mounted_roles(options.mounted, ROLES)
    with StopRequests("frame") as requests:
        try:
            shot = shoot_sensor(rig, folder, machine_wishes(requests, mounted, "calibrate"))
        except GonioError as error:
            if requests.exit_code is None:
                raise
            say(f"gonio calibrate: {' '.join(str(error).split())}")
            return None, requests.exit_code
        return shot, requests.exit_code


def _finish(
    options: argparse.Namespace,
    frames: Path,
    rig: Rig | None,
    folder: Path,
    *,
    lamp_temperature_deg_c: float | None = None,
) -> int:
    """Characterise the frames, write everything, tell."""
    from analysis.sensor_page import write_sensor_page
    from capture.characterise import characterise
    from capture.hot_pixels import HOT_PIXELS_FILE, save_hot_pixels
    from capture.sensor import save_sensor
    from capture.sensor_doubts import doubts_of
    from capture.sensor_frames import raw_files, sort_frames
    from capture.sensor_shots import require_serial
    from capture.sensor_summary import write_summary
    from rig.files import whole_file

    with at_work("working out the sensor's character"):
        sorted_frames = sort_frames(raw_files(frames), frames)
        if rig is not None:
            require_serial(rig, sorted_frames.first.camera_serial)
        character = characterise(sorted_frames)
    doubts = doubts_of(character)
    model = character.model(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        lamp_temperature_deg_c=lamp_temperature_deg_c,
        note="gonio calibrate sensor",
    )
    folder.mkdir(parents=True, exist_ok=True)
    write_summary(folder, character, model, doubts)
    write_sensor_page(folder / PAGE_FILE, character, model, doubts)
    current = folder.parent / "sensor.toml"
    with whole_file(current) as file:
        save_sensor(model, file)
    save_hot_pixels(character.dark.hot, folder.parent / HOT_PIXELS_FILE)
    _tell(options, character, current, folder, doubts)
    return 0


def _tell(
    options: argparse.Namespace, character: SensorCharacter, current: Path, folder: Path, doubts: list[str]
) -> None:
    from capture.sensor_summary import SUMMARY_FILE, quantities

    items = quantities(character)
    if options.json:
        facts: dict[str, Any] = {
            "calibration": str(current),
            "page": str(folder / PAGE_FILE),
            "summary": str(folder / SUMMARY_FILE),
            "quantities": {
                item.key: {"value": _finite(item.value), "u": _finite(item.u), "unit": item.unit}
                for item in items
            },
            "clip_dn": dict(zip(character.channels, character.clip_dn, strict=True)),
            "doubts": doubts,
        }
        print_json(facts)
    else:
        for item in items:
            sure = "" if item.u is None or not math.isfinite(item.u) else f" ± {item.u:.2g}"
            value = "unknown" if not math.isfinite(item.value) else f"{item.value:.5g}{sure} {item.unit}"
            print(f"{item.name:<42} {item.symbol:<9} {value}".rstrip())
        clips = ", ".join(f"{n} {c:g}" for n, c in zip(character.channels, character.clip_dn, strict=True))
        print(f"{'clip level, black included':<52} {clips} DN")
        print(f"{current}    page: {folder / PAGE_FILE}")
    for doubt in doubts:
        say(f"gonio calibrate: {doubt}")


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value
