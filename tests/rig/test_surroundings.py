"""The twin's surroundings in a rig file: read, written back, refused where they cannot be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rig.description import default_rig, dump_rig, load_rig
from rig.errors import BadInput
from rig.surroundings import PlanarMirror, SphericalMirror, TwinLight, parse_mirror

if TYPE_CHECKING:
    from pathlib import Path

TWIN = TwinLight(
    tolerance=0.01,
    housing_albedo=0.04,
    housing_side_mm=1600.0,
    mirrors=(
        PlanarMirror(centre_mm=(0.0, 80.0, 60.0), across_mm=(50.0, 0.0, 0.0), up_mm=(0.0, 20.0, 40.0)),
        SphericalMirror(vertex_mm=(-96.0, 0.0, 72.0), facing=(0.8, 0.0, -0.6), radius_mm=120.0, rim_mm=50.0),
    ),
)


def test_a_rig_file_keeps_them(tmp_path: Path) -> None:
    """Would catch mirrors that are lost when a rig is written, and a kind read as the other."""
    rig = default_rig(twin=TWIN)
    dump_rig(rig, tmp_path / "rig.toml")
    assert load_rig(tmp_path / "rig.toml").twin == TWIN


def test_files_without_them_are_the_machines_that_they_were() -> None:
    """Would catch a session that cannot go on because the program has learnt new words."""
    assert default_rig().hash == default_rig(twin=TwinLight()).hash != default_rig(twin=TWIN).hash


def test_lines_say_what_files_say() -> None:
    """Would catch a vector read backwards, and a default that a line does not have."""
    lines = (
        "planar:centre_mm=0/80/60,across_mm=50/0/0,up_mm=0/20/40",
        "spherical:vertex_mm=-96/0/72,facing=0.8/0/-0.6,radius_mm=120,rim_mm=50,reflectance=1",
    )
    assert tuple(parse_mirror(line) for line in lines) == TWIN.mirrors


@pytest.mark.parametrize(
    "line",
    ["", "round:rim_mm=3", "planar", "planar:centre_mm=1/2", "spherical:radius_mm", "planar:rim_mm=nan"],
)
def test_a_line_that_is_no_mirror_is_refused_in_one(line: str) -> None:
    """Would catch a traceback, or a mirror with made-up sides."""
    with pytest.raises(BadInput) as refused:
        parse_mirror(line)
    assert "\n" not in str(refused.value)
