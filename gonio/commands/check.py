"""Check BRDF samples of any laboratory: whether they are possible, and whether they agree with themselves.

FILE is anything that gonio reads; its content tells the format. Each check gives a number, a threshold, a
verdict (pass, warn, fail, or not tested, saying why), what it may mean and where to look: reciprocity, energy
with the coverage behind it, mirror symmetry, isotropy, duplicates, repeatability, negatives, clipped values,
coverage, and noise against the stated uncertainty. Nothing is changed. The exit code is 3 if a check fails.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gonio.output import add_json_option, print_json
from rig.errors import Refused

if TYPE_CHECKING:
    import argparse

    from analysis.checks import Finding

EXAMPLE = "gonio check radiance.csv --material Kupfer --as-published"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `gonio check`."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="samples to check")
    parser.add_argument("--wavelength-nm", nargs="+", type=float, metavar="W", help="only these channels")
    parser.add_argument("--max-theta-deg", type=float, metavar="T", help="leave out larger angles")
    parser.add_argument(
        "--blank", metavar="FILE", help="RT-300S: the measurement without a sample, subtracted"
    )
    parser.add_argument("--material", metavar="NAME", help="in-plane tables: which of several materials")
    parser.add_argument(
        "--as-published",
        action="store_true",
        help="in-plane radiances: with the published formula's cosine inside",
    )
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Check and print; see the module's description."""
    from analysis.checks import Verdict, check, worst
    from analysis.samples import read, select

    entries, failed = [], False
    for file in options.files:
        samples = select(
            read(
                file,
                blank=options.blank,
                material=options.material,
                as_published=options.as_published,
            ),
            wavelength_nm=options.wavelength_nm,
            max_theta_deg=options.max_theta_deg,
            where=file,
        )
        findings = check(samples)
        verdict = worst(findings)
        failed |= verdict is Verdict.FAIL
        if options.json:
            entries.append(
                {
                    "file": file,
                    "samples": samples.sizes["sample"],
                    "channels": [str(channel) for channel in samples["channel"].to_numpy()],
                    "verdict": verdict.value,
                    "checks": [_entry(finding) for finding in findings],
                }
            )
        else:
            size = f"{samples.sizes['sample']} samples in {samples.sizes['channel']} channel(s)"
            print("\n".join([f"{file}: {size}: {verdict.value}", "", *map(_line, findings), ""]))
    if options.json:
        print_json({"files": entries})
    return Refused.exit_code if failed else 0


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
    }


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
