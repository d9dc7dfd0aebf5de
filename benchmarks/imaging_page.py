"""Sets what `gonio bench imaging --json --plots docs/accuracy` printed as the page `docs/accuracy.md`.

    gonio bench imaging --json --plots docs/accuracy > numbers.json
    python -m benchmarks.imaging_page docs numbers.json [MORE.json ...]

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
    "imaging_merge": (
        "Error against light",
        "Many pixels see the same light in four exposures of a 14-bit sensor (0.4 DN per electron, 3 DN of "
        "read noise). Efficiency is the variance of the best estimate from the samples that the merge "
        "admits, with the weights that its ramp towards the clip level gives them, over the variance found. "
        "What the ramp costs is the dotted line: the bound of all samples that are not clipped. The Poisson "
        "estimate needs no sensor model and loses where read noise rules. Its variance takes the gain from "
        "the scatter of the frames of one scene.",
        ("merge.png", "Efficiency, bias and stated over true sigma against light"),
    ),
    "imaging_ratios": (
        "Exposure times that are wrong",
        "Stated times are off by up to 3 % each; the ratios are measured from the frames. Fitted times are "
        "used where the frames refute the stated ones, and leave a reduced chi-square of 1.",
        None,
    ),
    "imaging_flea3": (
        "A real camera",
        "Flea3, seven exposures, darks of the day: samples of 60 to 240 DN (of 255) against the merge; and "
        "its ColorChecker, found in all bands and in each. "
        "Pixels beside clipped ones read low on this CCD: such samples are left out, and the figure shows "
        "what they would have done to the merge. Where the other frames hold a few counts only (they tell "
        "less than 2 %) they are used, and flagged: the low bias stays there, as the smaller error. The "
        "camera cuts its counts, and its darks are too quiet to be as low: half a DN is added.",
        ("flea3.png", "550 nm: merge with samples beside clipped green against that without"),
    ),
    "imaging_peers": (
        "Other programs",
        "The same stack for all. On the simulated scene the truth is known; of the Flea3 bracket each frame "
        "judges the merge of the others, with its own noise. Only ours gives variance and flags, and takes "
        "frames with their pedestal.",
        ("peers.png", "Bias against light, and worst bias against time"),
    ),
    "imaging_speed": (
        "Time and memory",
        "CPU time of one thread, in pairs of runs that follow each other; memory of a process of its own. "
        "Compiled code merges such frames; the first merge ever on a machine waits some seconds for it.",
        None,
    ),
    "imaging_sensor": ("A sensor from its own frames", "The worst of eight simulated cameras.", None),
    "imaging_exposure": (
        "Brackets",
        "Frames and time that brackets need for a range of light and a signal-to-noise ratio.",
        ("imaging_exposure.png", "Signal-to-noise ratio over the range of light"),
    ),
    "imaging_corrections": (
        "Corrections",
        "Sessions of the twin under 1 % of stray light, with a lamp that loses 6 % and with a steady one; "
        "frames of closed-form light with a tilted flat field and a bent response. Errors of the worst "
        "pose's mean.",
        None,
    ),
    "imaging_coverage": (
        "Coverage of the stated intervals",
        "Sessions drawn at the reduction level, with systematic errors drawn anew for each.",
        None,
    ),
    "imaging_sessions": (
        "Coverage over rendered frames",
        "Frames of the twin's light and sensor, merged and reduced by the program; materials, poses, the "
        "joints' true angles, the white's albedo and evenness, the lamp's output and its photodiode's error "
        "drawn anew for each session.",
        None,
    ),
}
"""By part: its heading, what it does, and its figure."""

HEAD = """# Images to radiance, in numbers

Written by `python -m benchmarks.imaging_page docs numbers.json` from what
`gonio bench imaging --json --plots docs/accuracy > numbers.json` printed, or its parts, each run alone. A
part without a section was not run for this page. The Flea3 frames are public and not part of the project.
"""


def page(results: Sequence[dict[str, Any]]) -> str:
    """Set rows, named `part: name`, as a page with a section for each part."""
    return "\n".join([HEAD, *sections(results, TITLES, "accuracy")])


def main() -> int:
    """Write the page into the folder."""
    if len(sys.argv) < 3:
        print(__doc__)
        return 2
    results = gathered([Path(path) for path in sys.argv[2:]], TITLES)
    (Path(sys.argv[1]) / "accuracy.md").write_text(page(results), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
