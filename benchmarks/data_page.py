"""Sets what `gonio bench data --json --plots docs/data` printed as the page `docs/data.md`.

    gonio bench data --json --plots docs/data > numbers.json
    python -m benchmarks.data_page docs numbers.json [MORE.json ...]

Results of parts that were run again alone, named `PART.json`, take the place of that part's.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.rows import gathered, sections

if TYPE_CHECKING:
    from collections.abc import Sequence

TITLES: dict[str, tuple[str, str, tuple[str, str] | None]] = {
    "data_rt300s": (
        "A published chain, repeated",
        "The raw scans of two black coatings and their blank, through the recipes that ship, "
        "against the FRED and Zemax tables that the laboratory published. The cell at theta_s = 0"
        " is the mean over the full circle of azimuths (docs/recipes.md). One sample at three "
        "stage angles tells how well a file is repeated.",
        (
            "rt300s.png",
            "Differences of three files of one sample from their mean, against the level of the reading",
        ),
    ),
    "data_mwir": (
        "A published formula that breaks reciprocity",
        "In-plane mid-infrared tables as published and without the cosine of their formula, and "
        "the emissivity of the same samples against 1 - albedo. Samples on one side of one plane "
        "allow an albedo where several descriptions of the rest agree "
        "(`analysis/checks/in_plane.py`); how far that can be trusted is measured on materials "
        "whose whole hemisphere is known. Where they do not agree, or where no isotropic surface "
        "could have such values, the comparison is refused.",
        (
            "mwir.png",
            "Reciprocity with and without the cosine; albedos from one side of the plane against the whole",
        ),
    ),
    "data_exchange": (
        "Which format a file is, and Radiance's own tools",
        "Each file is shown to every format. A paint is written as PAB and taken through "
        "pabopto2bsdf, bsdf2klems and checkBSDF.",
        None,
    ),
    "data_rgl": (
        "Tables for renderers",
        "Written back: samples of a table through NetCDF and back, evaluated by Mitsuba's "
        "`measured` beside the original. From samples: the table is made again from random pairs "
        "of directions. Off the peak means f_r cos(theta_o) below half of its channel's largest, "
        "lights and views within 66 deg; errors are relative, the median over directions and "
        "channels. How many samples that takes is told by what their interpolation misses without "
        "a table: flakes change from node to node (their texture), and 50,000 samples lie as far "
        "apart as the nodes.",
        (
            "rgl.png",
            "Errors of tables made from scattered samples",
        ),
    ),
    "data_readers": (
        "Texts at their size limit",
        "One file of each kind, as many rows as fit; the last number damaged too. Short rows make the most "
        "samples: ten characters each.",
        None,
    ),
    "data_damaged": (
        "Damaged files",
        "Seeded damages of each format: cut, line ends, decimal commas, NaN, wrong counts, "
        "repeated directions, other byte order, empty, huge headers. The reader has 1 GB.",
        None,
    ),
    "doctor": (
        "The convention doctor",
        "Files corrupted on purpose; readings that give the same f_r within noise count as one.",
        None,
    ),
}
"""By part: its heading, what it does, and its figure."""

HEAD = """# Other laboratories' data, in numbers

Written by `python -m benchmarks.data_page docs numbers.json` from what
`gonio bench data --json --plots docs/data > numbers.json` printed (about half an hour), or its parts, each
run alone. A part without a section was not run for this page. The measurements are public (docs/formats.md
names the formats) and not part of the project.
"""


def page(results: Sequence[dict[str, Any]]) -> str:
    """Set rows, named `part: name`, as a page with a section for each part."""
    return "\n".join([HEAD, *sections(results, TITLES, "data")])


def main() -> int:
    """Write the page into the folder."""
    if len(sys.argv) < 3:
        print(__doc__)
        return 2
    results = gathered([Path(path) for path in sys.argv[2:]], TITLES)
    (Path(sys.argv[1]) / "data.md").write_text(page(results), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
