"""Files between programs: which format claims each file at hand, and Radiance's own tools on what is written.

Every file at hand is shown to every format's `sniff`: the one that reads it must be the only one that claims
it. A paint, measured on a grid, is written as PAB and taken through pabopto2bsdf, bsdf2klems and checkBSDF.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.formats import HEAD_BYTES, NAMES, clean_head, pab
from analysis.models import MODELS
from analysis.samples import make_samples
from benchmarks.rows import row
from rig.angles import spherical_to_direction
from rig.errors import BadInput
from tests.analysis.whole_files import make_merl, make_whole_files

if TYPE_CHECKING:
    from collections.abc import Iterator

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
AT_HAND = {
    "cornell/*.brdf": "cornell",
    "merl-standins/*.npz": "npz",
    "mwir/radiance.csv": "inplane",
    "rgl/*.bsdf": "rgl",
    "rt300s/published/*.txt": "fred",
    "rt300s/published/*.bsdf": "zemax",
    "rt300s/raw/*.xls": "rt300s",
    "rt300s/vendor-exports/*.xls": "rt300s",
    "rt300s/vendor-exports/*.jdv": "rt300s_text",
    "rt300s/vendor-exports/*.txt": "rt300s_text",
    "rt300s/vendor-exports/*.rtd": "rt300s_text",
    "starlink/chassis_brdf.csv": "inplane",
}
NOT_SAMPLES = (
    "README.md",
    "**/LICENSE*",
    "mwir/emissivity.csv",
    "cornell/macbeth/*",
    "flea3/**/*.tif",
    "nist-strd/*",
)
PAINT = {"kd": 0.2, "ks": 1.0, "m": 0.3, "ior": 1.5}
INCIDENCES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
RECIPROCITY_PERCENT = 10.0
TALKS = "bsdf2klems"
"""Prints its progress, and that WINDOW would like to know the maker and the thickness."""


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Sniff every file and run the tools; see the module.

    Raises
    ------
    BadInput
        If the data or the tools are not at hand.
    """
    del plots
    if not DATA.is_dir():
        raise BadInput("the shared measurements are not at hand", where=str(DATA), todo="put them there")
    with tempfile.TemporaryDirectory() as folder:
        return [*sniffing_rows(Path(folder)), *radiance_rows(Path(folder))]


def sniffing_rows(folder: Path) -> list[dict[str, Any]]:
    """Count files by the format that they are and those that claim them."""
    modules = {name: importlib.import_module(f"analysis.formats.{name}") for name in NAMES}
    made = {**make_whole_files(folder), "merl": make_merl(folder)}
    files = [(file.path, file.module) for file in made.values()]
    files += [(path, true) for pattern, true in AT_HAND.items() for path in sorted(DATA.glob(pattern))]
    right: dict[str, list[bool]] = {}
    wrong = 0
    for path, true in files:
        claims = _claims(path, modules)
        right.setdefault(true, []).append(claims == [true])
        wrong += len([name for name in claims if name != true])
    others = [path for pattern in NOT_SAMPLES for path in sorted(DATA.glob(pattern)) if path.is_file()]
    taken = sum(bool(_claims(path, modules)) for path in others)
    rows = [
        row(f"{name}: files claimed by it alone, of {len(found)}", sum(found), "", len(found), at_least=True)
        for name, found in sorted(right.items())
    ]
    return [
        row(f"files of samples claimed by another format, of {len(files)}", wrong, "", 0.0),
        row(f"other files that a format claims, of {len(others)}", taken, "", 0.0),
        *rows,
    ]


def _claims(path: Path, modules: dict[str, Any]) -> list[str]:
    with path.open("rb") as stream:
        head = clean_head(stream.read(HEAD_BYTES))
    return [name for name, module in modules.items() if module.sniff(head)]


def radiance_rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Take a paint through Radiance's tools; what one complains of counts as a line."""
    theta_o, phi_o = np.radians(np.meshgrid(np.arange(0.0, 86.0, 5.0), np.arange(0.0, 360.0, 10.0)))
    views = spherical_to_direction(theta_o.ravel(), phi_o.ravel())
    wi = np.repeat(spherical_to_direction(np.radians(INCIDENCES_DEG), 0.0), len(views), axis=0)
    wo = np.tile(views, (len(INCIDENCES_DEG), 1))
    paint = MODELS["cook-torrance"](**PAINT)
    paths, _ = pab.write_folder(make_samples(wi, wo, paint.evaluate(wi, wo)), folder / "pab")
    sir, xml = folder / "paint.sir", folder / "paint.xml"
    arguments = {
        "pabopto2bsdf": (paths, sir),
        "bsdf2klems": (["-n", "60", sir], xml),
        "checkBSDF": ([xml], folder / "checked.txt"),
    }
    for name, (given, out) in arguments.items():
        begin = time.perf_counter()
        done = _tool(name, *given)
        out.write_bytes(done.stdout)
        said = [line for line in done.stderr.splitlines() if name != TALKS or b"error" in line]
        complaints = len(said) + (done.returncode != 0)
        yield row(f"PAB, {name}: complaints", complaints, "", 0.0)
        yield row(f"PAB, {name}", time.perf_counter() - begin, "s")
    lines = (folder / "checked.txt").read_text().splitlines()
    _, reciprocity = (line.split()[2:] for line in lines if line.startswith("Interior Refl\t"))
    yield row("PAB, checkBSDF: reciprocity error", float(reciprocity[1]), "%", RECIPROCITY_PERCENT)


def _tool(name: str, *arguments: object) -> subprocess.CompletedProcess[bytes]:
    found = importlib.util.find_spec("pyradiance")
    if found is None or found.origin is None:
        raise BadInput("Radiance's tools are not at hand", todo="pip install pyradiance")
    home = Path(found.origin).parent
    path = f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        [home / "bin" / name, *map(str, arguments)],
        env={**os.environ, "PATH": path, "RAYPATH": f".:{home / 'lib'}"},
        capture_output=True,
        check=False,
    )
