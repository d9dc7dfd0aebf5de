"""Merge RAW brackets into radiance with variance and flags.

FILES are the frames of one scene at different exposures (RAW, DNG, or single-channel TIFF mosaics), or one
session folder, whose poses are then merged one by one into radiance/. Exposure times come from the files;
where a file carries none, from its name (_0250ms, _250ms), which is said; --exposure-s overrides both.
Darks of a frame's own exposure are subtracted as they are; other exposures are interpolated. Without
--sensor the weights are Poisson's. The ratios of neighbouring exposures are measured from the frames; where
they refute the stated times, the merge uses the fitted ones.

--inspect merges nothing and tells what each file states (camera, ISO, time, aperture, black, clip level),
what its counts show (clip level, bits in use, covered pixels), and what to know before they are merged: the
same picture twice, settings that changed between frames, a black level that drifts, stretched counts.

The .npz of --out holds radiance (DN/s), variance, flags, exposure_s (used), exposure_nominal_s, clip_dn, cfa,
channels, files, and of each pixel how well the frames agree: chi_square (weighted sum of squared residuals
over their variances), samples (how many frames it is of).

The JSON object:
  files, estimator, note, times ("nominal" or "fitted"), clip_dn, hot_pixels, out, preview
  exposures: [{file, source, nominal_s, measured_s, used_s}]
  ratios: [{shorter, longer, nominal, measured, u, blocks, clean}], null where not measurable
  fit: {chi_square, freedom, significant}, of the nominal ratios against the measured ones
  agreement: {range_dn, median, samples, clean_median, clean_samples, frames: [the same and file]}
  flags: {name: pixels}
  noise: {gain_dn_per_e, floor_dn2, source}
  dark: {exposures_s, frames, matched, sources} or null
with --inspect: frames: [{path, camera, serial, iso, exposure_s, f_number, white_balance, width_px, height_px,
cfa, black_dn, optical_black_dn, white_dn, clip_dn, highest_dn, bits, step_dn, missing_codes, linearised}],
clip_dn (measured by all frames), findings: [{what, files, todo}]; lists of four go by position, row by row
and for a session: estimator, note, radiance (the folder), poses: [{pose, role, station, file, frames, flags}]
"""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.output import Progress, add_json_option, print_json
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

    from capture.bracket import BracketMerge
    from capture.sensor import SensorModel

EXAMPLE = "gonio merge bracket_*.dng --dark dark_*.dng --out scene.npz --preview scene.png"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="frames of one bracket, or one session folder"
    )
    parser.add_argument(
        "--inspect", action="store_true", help="do not merge: tell what the files can be trusted for"
    )
    parser.add_argument("--dark", nargs="+", default=[], metavar="FILE", help="dark frames, any exposures")
    parser.add_argument(
        "--sensor", metavar="TOML", help="the sensor's calibration, and the hot pixels beside it"
    )
    parser.add_argument(
        "--exposure-s", metavar="LIST", help="exposure times in seconds, comma-separated, in order"
    )
    parser.add_argument(
        "--times",
        choices=("auto", "nominal", "fitted"),
        default="auto",
        help="times to merge with: auto (default) takes fitted ones where the frames refute the nominal",
    )
    parser.add_argument(
        "--truncated", action="store_true", help="the camera cuts its counts to whole DN, it does not round"
    )
    parser.add_argument("--out", metavar="FILE.npz", help="write radiance, variance and flags")
    parser.add_argument(
        "--preview", metavar="FILE.png", help="write a small picture, logarithmic, hot pixels filled"
    )
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Merge, write what was asked for, and report."""
    if options.inspect:
        return _run_inspection(options)
    from capture.bracket import merge_bracket
    from capture.hot_pixels import HOT_PIXELS_FILE, load_hot_pixels
    from capture.sensor import load_sensor

    sensor = load_sensor(options.sensor) if options.sensor else None
    if any(Path(file).is_dir() for file in options.files):
        return _run_session(options, sensor)
    result = merge_bracket(
        options.files,
        dark_files=options.dark,
        sensor=sensor,
        hot=load_hot_pixels(Path(options.sensor).with_name(HOT_PIXELS_FILE)) if options.sensor else None,
        exposure_s=_times(options.exposure_s),
        times=options.times,
        truncated=options.truncated,
        chi_square=bool(options.out),
    )
    if options.out:
        _write_npz(result, _with_suffix(options.out, ".npz"))
    if options.preview:
        _write_preview(result, _with_suffix(options.preview, ".png"))
    if options.json:
        print_json(_summary(result, options))
    else:
        _print_table(result, options)
    return 0


def _run_inspection(options: argparse.Namespace) -> int:
    from capture.bracket import exposure_from_name
    from capture.inspection import inspect_files
    from gonio.inspection_text import print_inspection

    given = _times(options.exposure_s)
    if given is not None and len(given) != len(options.files):
        what = f"{len(given)} exposure times for {len(options.files)} files"
        raise BadInput(what, where="--exposure-s", todo="give one per file, in order")
    files = [*options.files, *options.dark]
    named = [exposure_from_name(file) for file in files]
    found = inspect_files(files, [*given, *named[len(given) :]] if given else named)
    if options.json:
        print_json(asdict(found))
    else:
        print_inspection(found)
    return 0


def _run_session(options: argparse.Namespace, sensor: SensorModel | None) -> int:
    from capture.session import Session
    from capture.session_merge import RADIANCE_FOLDER, merge_session

    given = {"--dark": options.dark, "--exposure-s": options.exposure_s, "--out": options.out}
    given |= {"--preview": options.preview, "more files": options.files[1:]}
    for name, value in given.items():
        if value:
            what = f"{name} does not go with a session, which has its own frames, darks and times"
            raise BadInput(what, where=options.files[0], todo="leave it out")
    with Session.open(options.files[0]) as session:
        progress = Progress("merging", len(session.poses("sample")) + len(session.poses("white")))
        poses, report = [], None
        for done in merge_session(session, sensor):
            report = done.merged.report
            poses.append(
                {
                    "pose": done.record.index,
                    "role": done.record.role,
                    "station": done.record.station,
                    "file": str(done.path),
                    "frames": len(report.exposure_s),
                    "flags": _flag_counts(done.merged.flags),
                }
            )
            progress()
        folder = session.folder / RADIANCE_FOLDER
    estimator, note = (report.estimator, report.note) if report else ("", "")
    if options.json:
        print_json({"estimator": estimator, "note": note, "radiance": str(folder), "poses": poses})
        return 0
    print(f"{len(poses)} poses merged, {estimator}, into {folder}")
    if note:
        print(note)
    return 0


def _times(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        raise BadInput(
            f"{text!r} is not a list of seconds", where="--exposure-s", todo="write 0.1,0.2,0.4"
        ) from None


def _with_suffix(name: str, suffix: str) -> Path:
    path = Path(name)
    if path.suffix.lower() != suffix:
        raise BadInput(f"its ending is not {suffix}", where=name, todo=f"write {path.name}{suffix}")
    return path


def _write_npz(result: BracketMerge, path: Path) -> None:
    from capture.radiance import write_radiance

    first = result.frames[0]
    write_radiance(
        path,
        result.merged,
        exposure_nominal_s=result.nominal_s,
        files=[str(frame.path) for frame in result.frames],
        cfa=first.cfa,
        channels=first.channels,
    )


def _write_preview(result: BracketMerge, path: Path) -> None:
    import cv2

    from capture.radiance import preview
    from rig.files import whole_file

    first = result.frames[0]
    picture = preview(result.merged, first.cfa, first.channels)
    done, data = cv2.imencode(".png", picture[..., ::-1])
    if not done:
        raise BadInput("the picture could not be encoded", where=str(path), todo="leave --preview out")
    with whole_file(path) as file:
        file.write_bytes(data.tobytes())


def _flag_counts(flags: Any) -> dict[str, int]:
    import numpy as np

    from capture.merge import Flag

    return {str(flag.name): int(np.count_nonzero(flags & np.uint8(flag))) for flag in Flag}


def _summary(result: BracketMerge, options: argparse.Namespace) -> dict[str, Any]:
    report, names = result.merged.report, [str(frame.path) for frame in result.frames]
    overall = result.agreement.overall
    return {
        "files": names,
        "estimator": report.estimator,
        "note": report.note,
        "times": result.times,
        "exposures": [
            {"file": name, "source": source, "nominal_s": nominal, "measured_s": measured, "used_s": used}
            for name, source, nominal, measured, used in zip(
                names,
                result.time_sources,
                result.nominal_s,
                result.fit.exposure_s,
                result.used_s,
                strict=True,
            )
        ],
        "ratios": [
            {
                "shorter": names[ratio.shorter],
                "longer": names[ratio.longer],
                "nominal": ratio.nominal,
                "measured": ratio.value,
                "u": ratio.u,
                "blocks": ratio.blocks,
                "clean": ratio.clean,
            }
            for ratio in result.ratios
        ],
        "fit": {
            "chi_square": result.fit.chi_square,
            "freedom": result.fit.freedom,
            "significant": result.fit.significant,
        },
        "agreement": {
            "range_dn": result.agreement.range_dn,
            **vars(overall),
            "frames": [
                {"file": name, **vars(frame)}
                for name, frame in zip(names, result.agreement.frames, strict=True)
            ],
        },
        "flags": _flag_counts(result.merged.flags),
        "hot_pixels": int(result.dark.hot.sum()) if result.dark is not None else None,
        "clip_dn": report.clip_dn,
        "noise": vars(report.noise),
        "dark": None
        if result.dark is None
        else {
            "exposures_s": result.dark.exposure_s,
            "frames": result.dark.frames,
            "matched": report.dark_matched,
            "sources": result.dark_time_sources,
        },
        "out": options.out,
        "preview": options.preview,
    }


def _print_table(result: BracketMerge, options: argparse.Namespace) -> None:
    report, agreement = result.merged.report, result.agreement
    height, width = result.merged.radiance.shape
    size = f"{len(result.frames)} frames of {width} x {height}"
    print(f"{size}, {report.estimator}, {result.times} exposure times")
    if report.note:
        print(report.note)
    for what, sources in (("frames", result.time_sources), ("darks", result.dark_time_sources)):
        if "file name" in sources:
            print(f"exposure times of {sources.count('file name')} {what} are read from their file names")
    noise = report.noise
    print(f"noise {noise.source}: gain {noise.gain_dn_per_e:.4g} DN/e, floor {noise.floor_dn2**0.5:.3g} DN")
    if result.dark is not None:
        how = "matched by exposure" if report.dark_matched else "bias and rate fitted to"
        print(f"darks {how}: {sum(result.dark.frames)} frames, {int(result.dark.hot.sum())} hot pixels")
    low, high = agreement.range_dn
    print()
    print(f"{'nominal':>10} {'measured':>10} {'ratio':>8} {'u':>7} {'nominal':>8}   |frame/merge - 1| median")
    print(f"{'s':>10} {'s':>10} {'':>8} {'':>7} {'ratio':>8}   {low:.0f} to {high:.0f} DN, samples")
    before = {ratio.longer: ratio for ratio in result.ratios}
    for index, frame in enumerate(agreement.frames):
        ratio = before.get(index)
        columns = f"{result.nominal_s[index]:10.4g} {result.fit.exposure_s[index]:10.5g}"
        columns += _ratio_columns(ratio.value, ratio.u, ratio.nominal, ratio.clean) if ratio else " " * 28
        print(f"{columns}{_percent(frame.median)} {frame.samples:9d}")
    overall = agreement.overall
    rows = (
        ("all frames", overall.median, overall.samples),
        ("without samples beside clipped ones", overall.clean_median, overall.clean_samples),
    )
    for title, median, samples in rows:
        print(f"{title:>49}{_percent(median)} {samples:9d}")
    if not all(ratio.clean for ratio in result.ratios):
        print("* only from samples beside clipped ones: not used for the times")
    verdict = "refuted" if result.fit.significant else "confirmed"
    print(f"stated times {verdict}: chi-square {result.fit.chi_square:.1f} of {result.fit.freedom} ratios")
    print()
    counts = ", ".join(f"{name} {number}" for name, number in _flag_counts(result.merged.flags).items())
    print(f"flagged pixels: {counts}")
    for name in (options.out, options.preview):
        if name:
            print(f"written: {name}")


def _ratio_columns(value: float, u: float, nominal: float, clean: bool) -> str:
    measured = f" {value:8.4f} {u:7.4f}" if math.isfinite(value) else f" {'-':>8} {'-':>7}"
    return f"{measured} {nominal:8.4f}{' ' if clean else '*'} "


def _percent(value: float) -> str:
    return f"{100.0 * value:8.2f} %" if math.isfinite(value) else f"{'-':>10}"
