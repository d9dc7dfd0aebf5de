"""Write a session's page: coverage, one HDR frame, lobes, residuals, parameters, budget, a rendered sphere.

SESSION is the folder that `gonio capture` made; it is reduced first where samples.nc is not there yet.
report.html is written into the session: one file without links to the outside.

The JSON object: session, report, samples, fits: [{model, parameters: {name: {value, u}}, metrics}]
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gonio.output import Progress, add_json_option, print_json

if TYPE_CHECKING:
    import argparse

EXAMPLE = "gonio report sessions/blue-paint --model cook-torrance phong"

LEAD = "Bidirectional reflectance from calibrated images, against a white reference, with uncertainty."


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("session", metavar="SESSION", help="folder of a session")
    parser.add_argument(
        "--model",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="models to fit, the first is discussed (default: all, best first)",
    )
    parser.add_argument(
        "--out", metavar="FILE.html", help="write there (default: report.html in the session)"
    )
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Reduce if needed, fit, draw, write."""
    from analysis.reduce import reduce_session
    from analysis.report import write_report
    from analysis.samples import read, write
    from capture.session import Session
    from gonio.page import fit_models, machine_facts, measurement_of

    folder = Path(options.session)
    table = folder / "samples.nc"
    with Session.open(folder) as session:
        if not table.is_file():
            progress = Progress("poses", len(session.poses("sample")))
            write(reduce_session(session, progress=progress), table)
        samples = read(table)
        fits = fit_models(samples, options.model)
        measurement = measurement_of(session, samples, fits)
        facts = machine_facts(session.rig)
    out = Path(options.out) if options.out else folder / "report.html"
    title = f"Reflectance of {measurement.title}"
    write_report(out, title, [measurement], lead=LEAD, facts=facts)
    if options.json:
        entries = [
            {
                "model": fitted.model.NAME,
                "parameters": {
                    name: {"value": value, "u": fitted.u[name]} for name, value in fitted.parameters.items()
                },
                "metrics": fitted.metrics,
            }
            for fitted in fits
        ]
        print_json(
            {
                "session": options.session,
                "report": str(out),
                "samples": samples.sizes["sample"],
                "fits": entries,
            }
        )
    else:
        print(f"{out}")
    return 0
