"""RGL and MERL tables: what is kept bit for bit, what re-sampling loses, and how long it takes.

Each RGL file at hand is written back from its samples, after they were stored as NetCDF, and evaluated by
Mitsuba's `measured` beside the original; some of its samples are rejected, and it is made again from random
pairs of directions, as if a laboratory had measured those. Off the peak means values of f_r cos(theta_o)
below half of their channel's largest, lights and views within 66 deg; errors are relative, their median over
directions and channels. A table of flakes changes from node to node; how many samples that takes is told by
what the interpolation of the samples itself misses, without a table, and by the texture: how well each node
is known from its neighbours.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.formats import merl
from analysis.formats.rgl_resample import resample
from analysis.formats.rgl_table import Table
from analysis.formats.scattered import interpolant_of, usable
from analysis.formats.tensor import read_tensors, write_tensors
from analysis.models import MODELS
from analysis.samples import make_samples, read, write
from benchmarks.data_plots import draw_errors
from benchmarks.rows import row
from gonio.output import say
from rig.angles import spherical_to_direction
from rig.errors import BadInput
from simulator.light.reflectance import mitsuba_reflectance
from simulator.materials import parse_material
from simulator.variant import LLVM, SCALAR, choose_variant, load_mitsuba

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "rgl"
FEWER, PAIRS, ASKED = 50_000, 200_000, 5_000
"""Scattered samples: a table is made of the larger number, at which flakes are sampled too."""

PEAK_FRACTION = 0.5
TARGET_PERCENT = 1.0
LARGEST_DEG = 66.0
REJECTED = 20
SMOOTH: dict[str, Any] = {"kd": 0.3, "ks": 0.2, "m": 0.3, "ior": 1.5}
"""A paint, for timing."""


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Write every file back and make it again; see the module.

    Raises
    ------
    BadInput
        If the files are not at hand.
    """
    paths = sorted(FOLDER.glob("*.bsdf"))
    if not paths:
        raise BadInput("the shared measurements are not at hand", where=str(FOLDER), todo="put them there")
    with tempfile.TemporaryDirectory() as folder:
        errors: dict[str, dict[str, Array]] = {path.stem: {} for path in paths}
        rows = [row for path in paths for row in _file_rows(path, Path(folder), errors[path.stem])]
        if plots is not None:
            draw_errors(plots / "rgl.png", errors, PAIRS, TARGET_PERCENT)
        return [*rows, _few_samples_row(), *_merl_rows(Path(folder))]


def _file_rows(path: Path, folder: Path, errors: dict[str, Array]) -> list[dict[str, Any]]:
    """Write a file back and make it again; `errors` gets those of the new table, by variant."""
    table = Table(read_tensors(path), str(path))
    say(f"  {path.stem}: written back and re-sampled, about a minute")
    again = folder / "again.bsdf"
    write(read(path), folder / "samples.nc")
    write(read(folder / "samples.nc"), again)
    made = folder / "made.bsdf"
    rows = [
        row(f"{path.stem}: texture, nodes against their neighbours, median", _texture_percent(table), "%"),
        row(
            f"{path.stem}: nodes that change with {REJECTED} rejected ones",
            _changed_nodes(path, folder),
            "",
            float(REJECTED),
        ),
    ]
    rows += [*_sampled_rows(path.stem, table), *_made_rows(path.stem, table, made)]
    for variant in (SCALAR, LLVM) if choose_variant().variant == LLVM else (SCALAR,):
        name = f"{path.stem}, {variant}"
        true, kept = (_by_mitsuba(variant, file) for file in (path, again))
        size = np.maximum(np.abs(true), np.finfo(float).tiny)
        worst = float((np.abs(kept - true) / size).max())
        rows.append(row(f"{name}: written back, largest error", worst, "", 1e-5))
        off = true < PEAK_FRACTION * true.max(axis=0)
        errors[variant] = 100.0 * (np.abs(_by_mitsuba(variant, made) - true) / size)[off]
        what = f"{name}: from {PAIRS} samples, off the peak"
        rows += [
            row(f"{what}, median", float(np.median(errors[variant])), "%", TARGET_PERCENT),
            row(f"{what}, 90th percentile", float(np.percentile(errors[variant], 90.0)), "%"),
        ]
    return rows


def _sampled_rows(stem: str, table: Table) -> list[dict[str, Any]]:
    """Say how well samples tell what lies between them, before a table is made."""
    wo, wi = _asked()
    true = table.evaluate(wi, wo) / wo[:, 2:]
    off = true * wo[:, 2:] < PEAK_FRACTION * (true * wo[:, 2:]).max(axis=0)
    rows = []
    for count in (FEWER, PAIRS):
        found = interpolant_of(usable(_samples_of(table, count)))(wi, wo).f_r
        error = 100.0 * float(np.median((np.abs(found - true) / np.abs(true))[off]))
        rows.append(
            row(f"{stem}: {count} samples interpolated without a table, off the peak, median", error, "%")
        )
    return rows


def _made_rows(stem: str, table: Table, file: Path) -> list[dict[str, Any]]:
    """Make a table from scattered samples, and tell what it costs."""
    start = time.process_time()
    tensors, loss = resample(_samples_of(table, PAIRS))
    took_s = time.process_time() - start
    write_tensors(file, tensors)
    name = f"{stem}: {PAIRS} samples"
    return [
        row(f"{name}, told uncertainty between them", 100.0 * loss.u_between_relative, "%"),
        row(f"{name} to a table, processor time", took_s, "s", 60.0),
    ]


def _samples_of(table: Table, count: int) -> xr.Dataset:
    wi, wo = _directions(count, 11, 86.0), _directions(count, 12, 88.0)
    return make_samples(wi, wo, table.evaluate(wi, wo) / wo[:, 2:], channels=["R", "G", "B"])


def _changed_nodes(path: Path, folder: Path) -> int:
    """Reject some samples, write the file, and count the nodes that are not what they were."""
    samples = read(path)
    chosen = np.random.default_rng(0).choice(samples.sizes["sample"], REJECTED, replace=False)
    samples["flags"][chosen] = 1
    write(samples, folder / "edited.bsdf")
    before, after = (read(file)["f_r"].to_numpy() for file in (path, folder / "edited.bsdf"))
    return int((np.abs(after - before) > 1e-9 * np.abs(before)).any(axis=1).sum())


def _texture_percent(table: Table) -> float:
    """Median difference of nodes from the mean of their four neighbours: what no smooth f_r has."""
    value = table.values
    middle = value[..., 1:-1, 1:-1]
    around = value[..., 2:, 1:-1] + value[..., :-2, 1:-1] + value[..., 1:-1, 2:] + value[..., 1:-1, :-2]
    lit = middle > 0.0
    return 100.0 * float(np.median(np.abs(around / 4.0 - middle)[lit] / middle[lit]))


def _few_samples_row() -> dict[str, Any]:
    paint = MODELS["cook-torrance"](**SMOOTH)
    wi, wo = _directions(1439, 1, 75.0), _directions(1439, 2, 80.0)
    samples = make_samples(wi, wo, paint.evaluate(wi, wo))
    start = time.process_time()
    resample(samples)
    return row("1439 samples to a table, processor time", time.process_time() - start, "s", 6.0)


def _merl_rows(folder: Path) -> list[dict[str, Any]]:
    planes = np.random.default_rng(0).uniform(0.0, 3.0, (3, 90, 90, 180))
    first, second = folder / "first.binary", folder / "second.binary"
    merl.write_table(first, planes)
    merl.write_table(second, merl.read_table(first))
    differing = np.count_nonzero(
        np.frombuffer(first.read_bytes(), np.uint8) != np.frombuffer(second.read_bytes(), np.uint8)
    )
    paint = MODELS["cook-torrance"](**SMOOTH)
    wi, wo = _directions(1439, 1, 30.0), _directions(1439, 2, 40.0)
    start = time.process_time()
    loss = merl.write(make_samples(wi, wo, paint.evaluate(wi, wo)), folder / "holes.binary")
    return [
        row("MERL: bytes changed by reading and writing", float(differing), "", 0.0),
        row("MERL from 1439 samples, processor time", time.process_time() - start, "s", 10.0),
        row("MERL from 1439 samples: bins without samples, told", 100.0 * loss.filled_part, "%"),
    ]


def _by_mitsuba(variant: str, path: Path) -> Array:
    """f_r of a file by Mitsuba's `measured`, off grazing, for lights of one quadrant."""
    wo, wi = _asked()
    return np.asarray(mitsuba_reflectance(load_mitsuba(variant), parse_material(f"bsdf:{path}"))(wo, wi))


def _asked() -> tuple[Array, Array]:
    """Draw the views and lights that are compared."""
    lights, views = _directions(ASKED, 7, LARGEST_DEG), _directions(ASKED, 6, LARGEST_DEG)
    # Mitsuba leaves its symmetry of isotropic files unset: it does not matter in this quadrant.
    return views, np.abs(lights) * [-1.0, -1.0, 1.0]


def _directions(count: int, seed: int, largest_deg: float) -> Array:
    """Draw directions that are even over a cap."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(largest_deg)), 1.0, count))
    return spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, count))
