"""A drawing of the machine at a pose, from four sides, with the light's way, line of sight and nearest pair.

A convex solid looks from afar like the hull of its points, so each view is a plane of filled outlines, the
far ones first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull

from analysis.style import ACCENT, FAINT, INK, SERIES, figure
from rig.convex import Solids
from rig.placement import placed_solids

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from rig.angles import FloatArray
    from rig.clearance import Nearness
    from rig.convex import Convex
    from rig.description import Rig
    from rig.placement import PlacedSolid

_X, _Y, _Z = np.eye(3)
_CORNER = np.array([[-0.5, 0.8660254, 0.0], [-0.4330127, -0.25, 0.8660254], [0.75, 0.4330127, 0.5]])

VIEWS = (
    ("from the front", "x (mm)", "z (mm)", np.stack([_X, _Z, -_Y])),
    ("from the side", "y (mm)", "z (mm)", np.stack([_Y, _Z, _X])),
    ("from above", "x (mm)", "y (mm)", np.stack([_X, _Y, _Z])),
    ("from a corner", "", "", _CORNER),
)
"""Title, labels, and rows that carry the base's frame to right, up and towards the eye."""

ARM_COLOURS = {"light": SERIES[3], "camera": SERIES[0], "sample": SERIES[2], "base": FAINT}
LIGHT, SIGHT = "#e8b90f", SERIES[5]

_DIRECTIONS = 600


@dataclass(frozen=True)
class Drawn:
    """What is drawn beside the solids.

    Attributes
    ----------
    title : str
    beams : tuple of Convex
        The light's way to the sample, and the camera's rays: one of each.
    nearest : Nearness or None
    """

    title: str
    beams: tuple[Convex, Convex]
    nearest: Nearness | None


def draw_machine(rig: Rig, angles_rad: FloatArray, drawn: Drawn, path: Path) -> None:
    """Draw a machine at a pose, in the frame of its base.

    Parameters
    ----------
    rig : Rig
    angles_rad : ndarray, shape (J,)
    drawn : Drawn
    path : Path
        The PNG to write.
    """
    solids = placed_solids(rig, angles_rad, in_sample_frame=False)
    clouds = [(_surface(solid), ARM_COLOURS[_arm(rig, solid.name)]) for solid in solids]
    rays = [(_points(beam), colour) for beam, colour in zip(drawn.beams, (LIGHT, SIGHT), strict=True)]
    with figure(11.0, 9.5) as page:
        for axes, (title, right, up, view) in zip(page.subplots(2, 2).flat, VIEWS, strict=True):
            for depth, (points, colour) in enumerate(
                sorted(clouds, key=lambda cloud: _depth(cloud[0], view))
            ):
                _fill(axes, points @ view[:2].T, colour, depth)
            for points, colour in rays:
                _fill(axes, points @ view[:2].T, colour, len(clouds), alpha=0.45)
            if drawn.nearest is not None:
                _mark(axes, drawn.nearest, view)
            axes.set_title(title)
            axes.set_xlabel(right)
            axes.set_ylabel(up)
            axes.set_aspect("equal", adjustable="datalim")
            axes.autoscale_view()
        _legend(page.axes[-1], rig)
        page.suptitle(drawn.title, x=0.01, ha="left", fontsize=11)
        page.savefig(path, dpi=100, format="png", metadata={"Software": None})


def _arm(rig: Rig, name: str) -> str:
    """Arm that carries a solid: where arms share joints, the first that has its link."""
    link = next(solid.link for solid in rig.solids if solid.name == name)
    chains = {"light": rig.arms.light, "camera": rig.arms.camera, "sample": rig.arms.sample}
    return next((arm for arm, chain in chains.items() if link in chain), "base")


def _surface(solid: PlacedSolid) -> FloatArray:
    """Points of a solid whose hull is the solid, near enough for a drawing."""
    shape = solid.shape
    one = Solids(
        np.array([shape.half_mm]),
        np.array([shape.disc_mm]),
        np.array([shape.ball_mm]),
        solid.pose[None, :3, :3],
        solid.pose[None, :3, 3],
    )
    return _points(one)


def _points(solid: Convex) -> FloatArray:
    number = np.arange(_DIRECTIONS) + 0.5
    theta, phi = np.arccos(1.0 - 2.0 * number / _DIRECTIONS), np.pi * (1.0 + np.sqrt(5.0)) * number
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    rows = np.zeros(_DIRECTIONS, dtype=np.int64)
    return np.asarray(solid.support(rows, directions) + solid.ball_mm[0] * directions)


def _depth(points: FloatArray, view: FloatArray) -> float:
    return float((points @ view[2]).mean())


def _fill(axes: Axes, flat: FloatArray, colour: str, depth: int, alpha: float = 0.85) -> None:
    outline = flat[ConvexHull(flat, qhull_options="QJ").vertices]
    axes.fill(*outline.T, facecolor=colour, edgecolor=INK, linewidth=0.5, alpha=alpha, zorder=2 + depth)


def _mark(axes: Axes, nearest: Nearness, view: FloatArray) -> None:
    """Draw the shortest line between the nearest pair, with its length."""
    ends = nearest.points_mm @ view[:2].T
    axes.plot(*ends.T, color=ACCENT, marker="o", markersize=3, zorder=1000)
    axes.annotate(
        f"{nearest.distance_mm:.1f} mm",
        ends.mean(axis=0),
        xytext=(6, 6),
        textcoords="offset points",
        color=ACCENT,
        zorder=1000,
    )


def _legend(axes: Axes, rig: Rig) -> None:
    from matplotlib.patches import Patch

    arms = {_arm(rig, solid.name) for solid in rig.solids}
    named = {arm: colour for arm, colour in ARM_COLOURS.items() if arm in arms}
    named |= {"way of the light": LIGHT, "line of sight": SIGHT}
    axes.legend(handles=[Patch(color=colour, label=name) for name, colour in named.items()], loc="best")
