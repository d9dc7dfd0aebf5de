"""Write samples of any laboratory in another format, and say what that loses.

FILE is anything that gonio reads (docs/formats.md); its content tells the format. The end of OUT, or --to,
chooses the format to write. Several files of the same channels, such as one for each incidence, become one.
Where the format holds samples, the written file is read again and compared with what went in; where it
wants a grid, the samples are interpolated, and the errors of that are told. Cells of such a grid that no
sample is near are not invented: the command refuses, unless --fill allows it. Rejections of samples in a
.nc file that is written over are kept; where their samples are not found again, the command refuses.

Files are taken as they declare themselves. --reading NAME takes their angles and values otherwise, as
`gonio check --conventions` names it and docs/conventions.md lists; a .nc file records that. Samples that it
puts below the horizon are left out and counted.

The JSON object: files, out, format, samples, written, loss: {median_relative, p95_relative, worst_relative,
where_worst, u_between_relative, cells, filled, filled_part, dropped}, doubts
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.format_options import add_format_options, format_options
from gonio.output import add_json_option, at_work, caution, print_json
from gonio.overwriting import add_drop_option, keep_rejections, require_place
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

    import xarray as xr

    from analysis.formats.loss import Loss

EXAMPLE = "gonio convert garnet_red.brdf garnet_red.zemax.bsdf --wavelength-nm 550 --fill"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `gonio convert`."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="samples to convert")
    parser.add_argument("out", metavar="OUT", help="file to write; for --to pab a folder too")
    parser.add_argument(
        "--to", default="", metavar="FORMAT", help="netcdf, csv, rgl, merl, pab, zemax, astm, ssdd or fred"
    )
    parser.add_argument("--wavelength-nm", nargs="+", type=float, metavar="W", help="only these channels")
    parser.add_argument("--channel", nargs="+", metavar="C", help="only the channels of these names")
    parser.add_argument("--max-theta-deg", type=float, metavar="T", help="leave out larger angles")
    parser.add_argument("--reading", metavar="NAME", help="take the angles and values under that reading")
    parser.add_argument(
        "--fill", action="store_true", help="allow guesses in cells of a grid that no sample is near"
    )
    add_drop_option(parser)
    add_format_options(parser)
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Convert and say what was lost; see the module's description."""
    from analysis.conversion import convert
    from analysis.formats import require_writer
    from analysis.joining import join
    from analysis.samples import select

    out = Path(options.out)
    _require_other(out, options.files)
    require_writer(out, options.to)  # before the work, not after it
    require_place(out, options, to=options.to)
    tables = [
        select(
            _read(file, options),
            wavelength_nm=options.wavelength_nm,
            channels=options.channel,
            max_theta_deg=options.max_theta_deg,
            where=file,
        )
        for file in options.files
    ]
    below = sum(int(table.attrs.get("reading_left_out", 0)) for table in tables) if options.reading else 0
    samples, left_behind = join(tables, options.files)
    if below:
        left_behind = (*left_behind, f"{below} samples below the horizon under {options.reading}")
    doubts = caution(" ".join(options.files), samples.attrs)
    samples = keep_rejections(samples, out, options)
    with at_work(f"writing {out}"):
        done = convert(samples, out, to=options.to, fill=options.fill)
    result = {
        "files": options.files,
        "out": [str(path) for path in done.files],
        "format": done.format,
        "samples": samples.sizes["sample"],
        "written": done.samples,
        "loss": _entry(done.loss, left_behind),
        "doubts": doubts,
    }
    if options.json:
        print_json(result)
        return 0
    where = out if len(done.files) == 1 else f"{len(done.files)} files in {out}"
    print(f"{result['samples']} samples to {where} ({done.format}), {done.samples} read back")
    print(f"change: {done.loss}")
    if left_behind:
        print(f"not in the file, or not in all: {', '.join(left_behind)}")
    return 0


def _read(file: str, options: argparse.Namespace) -> xr.Dataset:
    """Read samples, under another reading where one is told."""
    from analysis.samples import read

    if not options.reading:
        return read(file, **format_options(options))
    from analysis.doctor import declared_table, reread
    from analysis.doctor_readings import reading_of

    return reread(declared_table(Path(file), format_options(options)), reading_of(options.reading))


def _require_other(out: Path, files: list[str]) -> None:
    for file in files:
        if out.exists() and Path(file).exists() and out.samefile(file):
            raise BadInput("is one of the files to convert", where=str(out), todo="write to another name")


def _entry(loss: Loss, left_behind: tuple[str, ...]) -> dict[str, Any]:
    entry = asdict(loss) | {"filled_part": loss.filled_part}
    return entry | {"dropped": [*loss.dropped, *left_behind]}
