"""Check BRDF samples of any laboratory: whether they are possible, and whether they agree with themselves.

FILE is anything that gonio reads; its content tells the format. Each check gives a number, a threshold, a
verdict (pass, warn, fail, or not tested, saying why), what it may mean and where to look: reciprocity, the
levels of the incidences, energy with the coverage behind it, mirror symmetry, the azimuth's offset, isotropy,
duplicates, repeatability, missing values, negatives, clipped values, outliers, coverage, noise against the
stated uncertainty both ways, and conventions. The exit code is 3 if a check fails.

Conventions: the file is read as degrees and radians, with zenith and azimuth or light and view exchanged,
with the other sign or sense of angles, relative to the mirror direction, with and without a cosine; the
readings are ranked by reciprocity, symmetry, smoothness and where the peak lies. --conventions prints the
ranking, also of files whose angles make no sense as declared, and where the evidence does not decide, what
measurement would. Nothing is changed, unless --reading NAME --out FILE writes the samples under that reading,
which the written file records.

Rejecting: --reject leaves samples of a .nc file out of every fit, with --reason, your name and the date in
the file's log; --restore NUMBER takes one back. SELECT is numbers (3,10-20), ranges in degrees
(theta_o=70..85 azimuth=-10..10), or the name of a check, which means the samples that it objects to.

The JSON object: files: [{file, samples, channels, verdict, checks: [{name, quantity, value, warn, fail,
count, verdict, meaning, where, objects_to}], conventions: {decided, words, to_decide, readings: [{reading,
words, same_as, log_odds, above_horizon, reciprocity, power, lobe_rms, noise_rms}]}, rejections: [...],
doubts}]
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.conventions_text import diagnosis_entry, ranking
from gonio.format_options import add_format_options, format_options
from gonio.output import add_json_option, caution, print_json
from gonio.overwriting import add_drop_option, keep_rejections, require_place
from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    import argparse

    import xarray as xr

    from analysis.checks import Finding
    from analysis.doctor import Diagnosis
    from analysis.rejection import Entry

EXAMPLE = (
    "gonio check radiance.csv --material Kupfer --as-published\n"
    "  gonio check garnet.brdf --conventions\n"
    "  gonio check samples.nc --reject theta_o=80..90 --reason 'stray light from the rail'"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `gonio check`."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="samples to check")
    parser.add_argument("--wavelength-nm", nargs="+", type=float, metavar="W", help="only these channels")
    parser.add_argument("--max-theta-deg", type=float, metavar="T", help="leave out larger angles")
    parser.add_argument(
        "--emissivity", metavar="E|FILE", help="of the same opaque surface, compared with 1 - albedo"
    )
    parser.add_argument("--html", metavar="FILE", help="write a page with the findings and pictures")
    conventions = parser.add_argument_group("conventions")
    conventions.add_argument(
        "--conventions", action="store_true", help="rank the readings, and check nothing"
    )
    conventions.add_argument(
        "--reading", metavar="NAME", help="take the angles and values under that reading"
    )
    conventions.add_argument("--out", metavar="FILE", help="write the samples under --reading there")
    rejecting = parser.add_argument_group("rejecting samples")
    rejecting.add_argument("--reject", nargs="+", metavar="SELECT", help="which samples to reject")
    rejecting.add_argument("--restore", type=int, metavar="NUMBER", help="which rejection to take back")
    rejecting.add_argument("--reason", metavar="TEXT", default="", help="why, kept in the file")
    rejecting.add_argument("--author", metavar="NAME", help="who (default: your login name)")
    add_drop_option(parser)
    add_format_options(parser)
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Check and print; see the module's description."""
    from analysis.checks import Verdict, worst

    _require_sense(options)
    if options.reject or options.restore is not None:
        return _edit(options)
    if options.reading:
        return _reread(options)
    if options.conventions:
        return _conventions(options)
    entries, pages, failed = [], [], False
    for file in options.files:
        samples = _read(file, options)
        findings, diagnosis = _examine(file, samples, options)
        verdict = worst(findings)
        failed |= verdict is Verdict.FAIL
        pages.append((file, samples, findings, diagnosis))
        if options.json:
            entries.append(_file_entry(file, samples, findings, diagnosis))
        else:
            size = f"{samples.sizes['sample']} samples in {samples.sizes['channel']} channel(s)"
            lines = [f"{file}: {size}: {verdict.value}", "", *map(_line, findings), *_rejections(samples), ""]
            print("\n".join(lines))
    if options.html:
        from analysis.check_page import write_check_page

        write_check_page(Path(options.html), pages)
    if options.json:
        print_json({"files": entries})
    return Refused.exit_code if failed else 0


def _require_sense(options: argparse.Namespace) -> None:
    """Refuse options that contradict one another before anything is read."""
    wanted = {
        "--reject": bool(options.reject),
        "--restore": options.restore is not None,
        "--reading": bool(options.reading),
        "--conventions": options.conventions,
        "--html": bool(options.html),
    }
    alone = [name for name, given in wanted.items() if given]
    if len(alone) > 1:
        raise BadInput("cannot be done at once", where=" and ".join(alone), todo="choose one of them")
    if bool(options.reading) != bool(options.out):
        missing, given = ("--out", "--reading") if options.reading else ("--reading", "--out")
        raise BadInput(f"needs {missing}", where=given, todo="name the reading, and the file to write")
    if options.reading and len(options.files) > 1:
        raise BadInput("takes one file", where="--reading", todo="name one")
    if options.drop_rejections and not options.out:
        raise BadInput("means nothing without --out", where="--drop-rejections", todo="leave it out")


def _read(file: str, options: argparse.Namespace) -> xr.Dataset:
    from analysis.samples import read, select

    samples = read(file, **format_options(options))
    caution(file, samples.attrs)
    return select(
        samples, wavelength_nm=options.wavelength_nm, max_theta_deg=options.max_theta_deg, where=file
    )


def _examine(file: str, samples: xr.Dataset, options: argparse.Namespace) -> tuple[list[Finding], Diagnosis]:
    """Run every check on one file."""
    from analysis.checks import check
    from analysis.checks.conventions import conventions
    from analysis.checks.emissivity import emissivity, read_emissivity
    from analysis.doctor import declared_table, diagnose
    from analysis.pairing import usable_samples

    findings = check(samples)
    if options.emissivity:
        known = read_emissivity(options.emissivity, Path(options.emissivity), options.material)
        findings.append(emissivity(usable_samples(samples), known))
    diagnosis = diagnose(declared_table(Path(file), format_options(options)))
    return [*findings, conventions(diagnosis)], diagnosis


def _conventions(options: argparse.Namespace) -> int:
    """Rank the readings of each file."""
    from analysis.doctor import declared_table, diagnose

    entries = []
    for file in options.files:
        table = declared_table(Path(file), format_options(options))
        doubts = caution(file, table.attributes)
        diagnosis = diagnose(table)
        if options.json:
            entries.append({"file": file, "conventions": diagnosis_entry(diagnosis), "doubts": doubts})
        else:
            print("\n".join(ranking(file, diagnosis)))
    if options.json:
        print_json({"files": entries})
    return 0


def _reread(options: argparse.Namespace) -> int:
    """Write the samples of one file under a reading."""
    from analysis.conversion import convert
    from analysis.doctor import declared_table, reread
    from analysis.doctor_readings import reading_of

    reading, out = reading_of(options.reading), Path(options.out)
    require_place(out, options)
    table = declared_table(Path(options.files[0]), format_options(options))
    doubts = caution(options.files[0], table.attributes)
    samples = reread(table, reading)
    left_out = samples.attrs["reading_left_out"]
    loss = convert(keep_rejections(samples, out, options), out).loss
    if options.json:
        found = {"samples": samples.sizes["sample"], "left_out": left_out, "doubts": doubts}
        print_json({"out": options.out, "reading": reading.name, **found})
    else:
        print(
            f"{options.out}: {reading.words}; {samples.sizes['sample']} samples, {left_out} left out; {loss}"
        )
    return 0


def _edit(options: argparse.Namespace) -> int:
    """Reject samples, or take a rejection back, in each file."""
    import getpass
    from datetime import UTC, datetime

    from analysis.checks import check
    from analysis.rejection import chosen, reject, require_store, restore
    from analysis.samples import channel_numbers, read, write

    facts = {
        "reason": options.reason,
        "author": getpass.getuser() if options.author is None else options.author,
        "date": datetime.now(UTC),
    }
    entries = []
    for path in [require_store(Path(file)) for file in options.files]:
        samples = read(path)
        if options.reject:
            found = {each.name: each.samples for each in check(samples)}
            numbers = chosen(samples, options.reject, found)
            channels = channel_numbers(samples, options.wavelength_nm, where=str(path))
            selection = " ".join(options.reject)
            edited = reject(samples, numbers, selection=selection, channels=channels, **facts)
        else:
            edited = restore(samples, options.restore, **facts)
        write(edited, path)
        entries.append({"file": str(path), "rejections": _log_entries(edited)})
        if not options.json:
            print("\n".join([f"{path}:", *_rejections(edited)]))
    if options.json:
        print_json({"files": entries})
    return 0


def _file_entry(
    file: str, samples: xr.Dataset, findings: list[Finding], diagnosis: Diagnosis
) -> dict[str, Any]:
    from analysis.checks import worst
    from analysis.formats.doubts import ATTRIBUTE

    return {
        "file": file,
        "samples": samples.sizes["sample"],
        "channels": [str(channel) for channel in samples["channel"].to_numpy()],
        "verdict": worst(findings).value,
        "checks": [_entry(finding) for finding in findings],
        "conventions": diagnosis_entry(diagnosis),
        "rejections": _log_entries(samples),
        "doubts": str(samples.attrs.get(ATTRIBUTE, "")),
    }


def _entry(finding: Finding) -> dict[str, Any]:
    return {
        "name": finding.name,
        "quantity": finding.quantity,
        "value": finding.value,
        "warn": finding.warn,
        "fail": finding.fail,
        "count": finding.count,
        "verdict": finding.verdict.value,
        "meaning": finding.meaning,
        "where": finding.where,
        "objects_to": finding.samples,
    }


def _log_entries(samples: xr.Dataset) -> list[dict[str, Any]]:
    from dataclasses import asdict

    from analysis.rejection import log_of

    return [asdict(entry) for entry in log_of(samples)]


def _line(finding: Finding) -> str:
    """Set one finding for people: the verdict and the number, and below it why and where."""
    import math

    value = "-" if math.isnan(finding.value) else f"{finding.value:.4g}"
    limits = f"warn > {finding.warn:g}" + (
        f", fail > {finding.fail:g}" if math.isfinite(finding.fail) else ""
    )
    head = f"  {finding.verdict.value:<10}  {finding.name:<16} {value:>9}  {finding.quantity} ({limits})"
    notes = [f"{'':14}{text}" for text in (finding.meaning, finding.where) if text]
    return "\n".join([head, *notes])


def _rejections(samples: xr.Dataset) -> list[str]:
    """Set the log of rejections for people."""
    from analysis.rejection import log_of, standing

    active = {entry.number for entry in standing(samples)}
    return [_log_line(entry, stands=entry.number in active) for entry in log_of(samples)]


def _log_line(entry: Entry, *, stands: bool) -> str:
    what = f"takes back {entry.of}" if entry.of else f"rejects {entry.selection or entry.samples}"
    state = "" if entry.of or stands else " (taken back)"
    why = f": {entry.reason}" if entry.reason else ""
    return f"  {entry.number}  {entry.date}  {entry.author} {what}{state}{why}"
