"""The choice of methods over scenes drawn from a seed: whether it is right, and quick.

At each tolerance every scene is rendered as the chooser decides, and in every other way that might be
quicker: all divisions of its light among methods, all that could be skipped. Errors are those against
`benchmarks.light_truth`. A way is right if its error is within the tolerance, by luck or by merit. Times are
processor times of one pose, its kernels compiled. A decision is paid as a session pays it, which asks for
many poses of a scene at once; what a pose costs that is decided alone, and what a scene costs before its
first one, is told besides.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from analysis.style import SERIES, figure
from benchmarks.light_scenes import draw_scenes
from benchmarks.light_truth import truth_of
from benchmarks.rows import row
from gonio.output import Progress
from rig.errors import Refused
from simulator import bsdfs
from simulator.light.choice import Chooser
from simulator.light.methods import METHODS
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from benchmarks.light_scenes import Drawn
    from benchmarks.light_truth import Truth
    from simulator.light.choice import Part

Array = NDArray[np.float64]

SCENES, SEED = 60, 20261123
TOLERANCES = (1e-2, 1e-3)
SHARE_TARGET, TWICE = 0.95, 2.0
WORTH_A_LOOK = 2.0
"""Ways whose predicted time is above this multiple of the choice's are not tried: they are not quicker."""
REPEATS, LONG_S = 3, 0.1
SESSION = 64
"""Poses that are decided at once."""
SMALLEST = 1e-6
"""Errors below are drawn here."""


@dataclass(frozen=True)
class Way:
    """One way to render a scene: its methods, its parts in words, its error, its time."""

    methods: tuple[str, ...]
    name: str
    error: float
    seconds: float
    predicted_s: float


@dataclass(frozen=True, eq=False)
class Judged:
    """One scene at one tolerance.

    Attributes
    ----------
    drawn : Drawn
    tolerance : float
    reached : bool
        Whether the decision promises the tolerance.
    chosen : Way
    deciding_s, alone_s, scene_s : float
        Time of a decision: of one pose among many, of one by itself, and of what a scene needs before.
    others : list of Way
    """

    drawn: Drawn
    tolerance: float
    reached: bool
    chosen: Way
    deciding_s: float
    alone_s: float
    scene_s: float
    others: list[Way]

    @property
    def quickest(self) -> Way:
        """The quickest way that is right; the chosen one if none is."""
        right = [way for way in self.others if way.error <= self.tolerance]
        return min([*right, self.chosen], key=lambda way: way.seconds)

    @property
    def slower_by(self) -> float:
        """Time of the chosen way over that of the quickest that is right."""
        return self.chosen.seconds / self.quickest.seconds

    @property
    def with_deciding(self) -> float:
        """The same, with the time of the decision on one side."""
        return self.slower_by * (1.0 + self.deciding_s / self.chosen.seconds)

    @property
    def with_deciding_alone(self) -> float:
        """The same, if each pose is decided by itself."""
        return self.slower_by * (1.0 + self.alone_s / self.chosen.seconds)


@dataclass(eq=False)
class Renderings:
    """Parts of one scene, each rendered and timed once."""

    mi: Any
    drawn: Drawn
    found: dict[tuple[str, tuple[str, ...], float], tuple[Array, float]] = field(default_factory=dict)

    def of(self, part: Part) -> tuple[Array, float]:
        """Return a part's radiance, and the time of a pose once its kernels are there."""
        key = part.method.name, tuple(one.name for one in part.classes), part.tolerance
        if key not in self.found:
            evaluator = part.method.build(self.mi, self.drawn.scene, part.paths)
            pose = self.drawn.pose
            radiance, times = evaluator.render(pose, part.tolerance).radiance, []
            while len(times) < REPEATS and sum(times) < LONG_S:
                begin = time.process_time()
                evaluator.render(pose, part.tolerance)
                times.append(time.process_time() - begin)
            self.found[key] = radiance, min(times)
        return self.found[key]

    def way(self, parts: Sequence[Part], truth: Truth) -> Way:
        """Render all parts of a way."""
        found = [self.of(part) for part in parts]
        name = " + ".join(f"{part.method.name} ({', '.join(c.name for c in part.classes)})" for part in parts)
        error = truth.error(np.sum([radiance for radiance, _ in found], axis=0))
        methods = tuple(part.method.name for part in parts)
        return Way(methods, name, error, sum(s for _, s in found), sum(part.seconds for part in parts))


def judge(mi: Any, drawn: Drawn, truth: Truth, tolerance: float) -> Judged:
    """Hold the choice for one scene against all other ways."""
    renderings = Renderings(mi, drawn)
    begin = time.process_time()
    chooser = Chooser(mi, drawn.scene, tolerance, METHODS)
    decision = chooser.decide(drawn.pose)
    scene_s = time.process_time() - begin
    deciding, alone = [], []
    for step in range(1, REPEATS + 1):
        # Other poses each time: nothing that is kept of the last ones helps.
        aside = 1e-7 * (1.0 + tolerance) * (step + 10 * np.arange(SESSION))
        nearby = [tuple(angle + float(k) for angle in drawn.pose) for k in aside]
        begin = time.process_time()
        chooser.decide_many(nearby[1:])
        between = time.process_time()
        chooser.decide(nearby[0])
        alone.append(time.process_time() - between)
        deciding.append((between - begin) / (SESSION - 1))
    chosen = renderings.way(decision.parts, truth)
    others = [
        renderings.way(parts, truth)
        for parts in chooser.ways(drawn.pose)
        if sum(part.seconds for part in parts) < WORTH_A_LOOK * max(chosen.seconds, chosen.predicted_s)
    ]
    return Judged(drawn, tolerance, decision.reached, chosen, min(deciding), min(alone), scene_s, others)


def study(mi: Any, count: int = SCENES, seed: int = SEED) -> tuple[list[Judged], list[Drawn]]:
    """Judge scenes at every tolerance; those that show no sample are drawn again.

    Returns
    -------
    judged : list of Judged
    refused : list of Drawn
        For which the chooser says that nothing covers their light.
    """
    judged: list[Judged] = []
    refused: list[Drawn] = []
    progress, done = Progress("scenes", count), 0
    for drawn in draw_scenes(mi, 3 * count, seed):
        try:
            for tolerance in TOLERANCES:
                Chooser(mi, drawn.scene, tolerance, METHODS).decide(drawn.pose)
        except Refused:
            refused.append(drawn)
            continue
        truth = truth_of(mi, drawn, min(TOLERANCES))
        if truth is None:
            continue
        judged += [judge(mi, drawn, truth, tolerance) for tolerance in TOLERANCES]
        done += 1
        progress(note=drawn.label)
        if done == count:
            break
    return judged, refused


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Judge all scenes; rows as `gonio bench` prints them."""
    mi = load_mitsuba("llvm")
    bsdfs.register(mi)
    judged, refused = study(mi)
    if plots is not None:
        draw(plots / "light_chooser.png", judged)
    return rows_of(judged, refused)


def rows_of(judged: Sequence[Judged], refused: Sequence[Drawn]) -> list[dict[str, Any]]:
    """Sum scenes up in rows."""
    rows = [each for tolerance in TOLERANCES for each in _rows(judged, tolerance)]
    return [*rows, row("scenes refused, besides: a mirror in a housing", len(refused))]


def _rows(judged: Sequence[Judged], tolerance: float) -> list[dict[str, Any]]:
    those = [one for one in judged if one.tolerance == tolerance]
    worst = max(those, key=lambda one: one.chosen.error)
    slowest = max(those, key=lambda one: one.slower_by)
    slower, deciding, alone = (
        np.array([getattr(one, key) for one in those])
        for key in ("slower_by", "with_deciding", "with_deciding_alone")
    )
    ratios = [one.chosen.predicted_s / one.chosen.seconds for one in those]
    label = f"{len(those)} scenes, tolerance {tolerance:g}"
    return [
        row(f"{label}: error, worst ({worst.drawn.label})", worst.chosen.error, "", tolerance),
        row(f"{label}: error, median", np.median([one.chosen.error for one in those])),
        row(f"{label}: decisions that promise the tolerance", np.mean([one.reached for one in those])),
        row(
            f"{label}: share within 2x of the quickest right way, rendering",
            np.mean(slower <= TWICE),
            "",
            SHARE_TARGET,
            at_least=True,
        ),
        row(
            f"{label}: share within 2x of the quickest right way, deciding included",
            np.mean(deciding <= TWICE),
            "",
            SHARE_TARGET,
            at_least=True,
        ),
        row(f"{label}: the same, if each pose is decided by itself", np.mean(alone <= TWICE)),
        row(f"{label}: time over the quickest right way's, median", np.median(slower), "x"),
        row(f"{label}: the same, worst ({slowest.drawn.label})", slower.max(), "x"),
        *(_slow_row(label, one) for one in those if one.slower_by > TWICE),
        *(
            row(f"{label}: time of a decision, {what}, median", 1e3 * np.median(times), "ms")
            for what, times in (
                (f"one of {SESSION} poses", [one.deciding_s for one in those]),
                ("by itself", [one.alone_s for one in those]),
                ("the first of a scene", [one.scene_s for one in those]),
            )
        ),
        row(f"{label}: predicted over measured time, lowest tenth", np.quantile(ratios, 0.1), "x"),
        row(f"{label}: predicted over measured time, highest tenth", np.quantile(ratios, 0.9), "x"),
    ]


def _slow_row(label: str, one: Judged) -> dict[str, Any]:
    """Name a scene whose choice is not quick, and what would have been."""
    quicker = f"{one.quickest.name}, error {one.quickest.error:.2g}"
    return row(
        f"{label}: slower than twice ({one.drawn.label}): {one.chosen.name}; quicker: {quicker}",
        one.slower_by,
        "x",
    )


def draw(path: Path, judged: Sequence[Judged]) -> None:
    """Draw error against time: a dot for each way of each scene, the chosen one in a ring."""
    with figure(9.0, 4.2) as drawn:
        panels = drawn.subplots(1, len(TOLERANCES), sharey=True)
        colours: dict[str, str] = {}
        for axes, tolerance in zip(panels, TOLERANCES, strict=True):
            those = [one for one in judged if one.tolerance == tolerance]
            for one in those:
                for way in one.others:
                    kind = way.methods[-1]
                    colour = colours.setdefault(kind, SERIES[len(colours) % len(SERIES)])
                    axes.plot(1e3 * way.seconds, max(way.error, SMALLEST), ".", color=colour, ms=3.5)
                at = 1e3 * one.chosen.seconds, max(one.chosen.error, SMALLEST)
                axes.plot(*at, "o", mfc="none", mec="0.15", mew=0.7, ms=6.5)
            axes.axhline(tolerance, color="0.5", lw=0.8, ls="--")
            axes.set(xscale="log", yscale="log", xlabel="processor time of a pose, ms")
            axes.set_title(f"tolerance {tolerance:g}, {len(those)} scenes")
        panels[0].set_ylabel("RMS error over mean radiance")
        handles = [Line2D([], [], ls="", marker="o", ms=4, color=c) for c in colours.values()]
        drawn.legend(handles, list(colours), loc="outside lower center", ncol=3, fontsize="small")
        drawn.savefig(path, dpi=110, metadata={"Software": None})
