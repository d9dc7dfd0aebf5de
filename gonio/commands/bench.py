"""Run benchmarks from a checkout: time against error, against peers, measured in this run.

PART names a file of the checkout's benchmarks/ folder; without it all parts run. A part is a module with a
function run(plots), where plots is a folder for figures or None, that gives rows of name, value, unit,
target (the bound, null for information only) and ok, printed as they come. A part can consist of others, its
PARTS. Numerical libraries get one thread, so that times compare. The exit code is 1 where a target is missed.
The JSON object: results, a list of these rows.
"""

from __future__ import annotations

import importlib.util
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.output import add_json_option, print_json
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

EXAMPLE = "gonio bench imaging --plots figures"

EXIT_TARGET_MISSED = 1
_RUN = re.compile(r"^def run\(", re.MULTILINE)
_KEYS = ("name", "value", "unit", "target", "ok")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("parts", nargs="*", metavar="PART", help="what to measure; all parts by default")
    parser.add_argument("--plots", metavar="FOLDER", help="write figures of time against error there")
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Run the parts and print their rows."""
    folder = _folder()
    known = sorted(path.stem for path in folder.glob("*.py") if _RUN.search(path.read_text("utf-8")))
    for part in options.parts:
        if part not in known:
            raise BadInput("no such benchmark", where=part, todo=f"there are: {', '.join(known)}")
    for name in _THREADS:  # read when numpy is first imported
        os.environ.setdefault(name, "1")
    if str(folder.parent) not in sys.path:  # parts import one another as `benchmarks.PART`
        sys.path.insert(0, str(folder.parent))
    modules = {part: _load(folder / f"{part}.py") for part in options.parts or known}
    contained = {inner for module in modules.values() for inner in getattr(module, "PARTS", ())}
    plots = None
    if options.plots:
        plots = Path(options.plots)
        plots.mkdir(parents=True, exist_ok=True)
    results: list[dict[str, Any]] = []
    for part, module in modules.items():
        if not options.parts and part in contained:
            continue
        if not options.json:
            print(part, flush=True)
        for row in module.run(plots):
            results.append({key: row[key] for key in _KEYS})
            if not options.json:
                _print_row(row)
    if options.json:
        print_json({"results": results})
    return 0 if all(row["ok"] for row in results) else EXIT_TARGET_MISSED


def _folder() -> Path:
    folder = Path(__file__).resolve().parents[2] / "benchmarks"
    if not folder.is_dir():
        what = "benchmarks run from a checkout, and this gonio is installed without one"
        raise BadInput(what, todo="clone the repository, run make, then .venv/bin/gonio bench there")
    return folder


def _load(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(f"benchmarks.{path.stem}", path)
    if spec is None or spec.loader is None:
        raise BadInput("it cannot be loaded", where=str(path), todo="it must be a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up by name
    spec.loader.exec_module(module)
    return module


def _print_row(row: dict[str, Any]) -> None:
    target = "" if row["target"] is None else f"target {row['target']:g}"
    verdict = "ok" if row["ok"] else "MISSED"
    print(f"  {row['name']:<58} {row['value']:10.4g} {row['unit']:<8} {target:<14} {verdict}", flush=True)
