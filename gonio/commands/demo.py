"""Measure three materials on the twin, from the wires to the report: the whole chain in one command.

Starts the twin, and for each material captures a session over real Dynamixel packets, a real serial line and
real RAW files, reduces it to BRDF samples, fits the model that made the material, and sets what was recovered
beside what is true. Everything is kept in the output folder; each step is the command a person would type.

The JSON object: seconds, poses, materials: [{name, model, parameters: {name: {true, value, u}}}], report;
values are lists by channel.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.demo_samples import SAMPLES, DemoSample, Pose, few
from gonio.output import Progress, add_json_option, print_json, say
from rig.errors import BadInput, DeviceLost, Refused

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence
    from types import TracebackType

    import xarray as xr

    from analysis.fit import FitResult
    from analysis.report import Measurement

EXAMPLE = "gonio demo --out gonio-demo"

MARKER = "demo.json"
DEFAULT_OUT = "gonio-demo"
DEFAULT_SPEED = 100.0
FEWEST_POSES = 12
EXIT_INTERRUPTED = 130


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="decides noise and hidden truths")
    parser.add_argument(
        "--out", default=DEFAULT_OUT, metavar="DIR", help=f"where everything is kept (default: {DEFAULT_OUT})"
    )
    parser.add_argument(
        "--speed", type=float, default=DEFAULT_SPEED, metavar="K", help="how many times faster the twin runs"
    )
    parser.add_argument(
        "--poses",
        type=int,
        metavar="N",
        help=f"poses of each material, {FEWEST_POSES} or more (default: all)",
    )
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Capture, reduce, fit, report."""
    if options.poses is not None and options.poses < FEWEST_POSES:
        raise BadInput(
            f"{options.poses} poses are too few to fit", where="--poses", todo=f"give {FEWEST_POSES} or more"
        )
    start = time.monotonic()
    out = prepare_folder(Path(options.out), options.seed)
    measured = _measure(out, options.seed, options.speed, options.poses)
    report = _write_report(out, measured)
    result = {
        "seconds": round(time.monotonic() - start, 2),
        "poses": sum(entry.poses for entry in measured),
        "materials": [entry.summary() for entry in measured],
        "report": str(report),
    }
    _write_marker(out, options.seed, result)
    if options.json:
        print_json(result)
    else:
        _print_tables(measured, result)
    return 0


def prepare_folder(out: Path, seed: int) -> Path:
    """Make the output folder, replacing an earlier demonstration and nothing else.

    Raises
    ------
    Refused
        The folder holds something else.
    """
    if out.exists() and not out.is_dir():
        raise Refused("is not a folder", where=str(out), todo="give another --out")
    if out.is_dir() and any(out.iterdir()):
        if not _is_demo(out):
            raise Refused(
                "holds something that is no demonstration",
                where=str(out),
                todo="give an empty or a new --out",
            )
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    _write_marker(out, seed, None)
    return out


def _is_demo(folder: Path) -> bool:
    try:
        return "gonio_demo" in json.loads((folder / MARKER).read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return False


def _write_marker(out: Path, seed: int, result: Mapping[str, Any] | None) -> None:
    content = json.dumps({"gonio_demo": 1, "seed": seed, "result": result}, indent=2)
    (out / MARKER).write_text(content + "\n", encoding="utf-8")


class Measured:
    """One material, captured, reduced and fitted.

    Parameters
    ----------
    sample : DemoSample
        What was measured.
    session : Path
        Its session.
    """

    def __init__(self, sample: DemoSample, session: Path) -> None:
        from analysis.fit import fit

        self.sample, self.session = sample, session
        self.samples, self.poses = _reduce(sample, session)
        self.fitted: FitResult = fit(self.samples, sample.model)
        self.truth = true_parameters(sample.material)

    def summary(self) -> dict[str, Any]:
        """Give true and recovered parameters, each a list by channel."""
        channels = self.samples.sizes["channel"]
        numbers = {name: (value, self.fitted.u[name]) for name, value in self.fitted.parameters.items()}
        numbers |= self.fitted.derived
        return {
            "name": self.sample.name,
            "model": self.sample.model,
            "parameters": {
                name: {
                    "true": self.truth[name],
                    "value": _by_channel(value, channels),
                    "u": _by_channel(u, channels),
                }
                for name, (value, u) in numbers.items()
            },
        }

    def measurement(self) -> Measurement:
        """Collect what the report shows."""
        from capture.session import Session
        from gonio.page import measurement_of

        with Session.open(self.session) as session:
            return measurement_of(
                session,
                self.samples,
                [self.fitted],
                title=self.sample.name,
                truth=self.truth,
                facts={"Material of the twin": self.sample.material},
            )


def true_parameters(material: str) -> dict[str, list[float]]:
    """Give a material's parameters by channel, with the derived specular reflectance at normal incidence."""
    from simulator.materials import parse_material

    truth = dict(parse_material(material).truth)
    if "ior" in truth:
        pairs = zip(truth["ks"], truth["ior"], strict=True)
        truth["ks_F0"] = [ks * ((ior - 1) / (ior + 1)) ** 2 for ks, ior in pairs]
    return truth


def _by_channel(value: Any, channels: int) -> list[float]:
    import numpy as np

    return [float(number) for number in np.broadcast_to(np.atleast_1d(value), (channels,))]


def _measure(out: Path, seed: int, speed: float, poses: int | None) -> list[Measured]:
    """Capture the materials one after the other; each is reduced while the next is captured."""
    from simulator.twin import Twin

    materials = {sample.station: sample.material for sample in SAMPLES}
    measured: list[Measured] = []
    with Twin(materials, seed=seed, speed=speed, folder=out / "twin", log=False) as twin:
        for number, sample in enumerate(SAMPLES):
            with _Capture(out, sample, few(sample.poses, poses), twin.rig):
                waiting = SAMPLES[len(measured) : number]
                measured += [Measured(earlier, _session(out, earlier)) for earlier in waiting]
    measured += [Measured(sample, _session(out, sample)) for sample in SAMPLES[len(measured) :]]
    return measured


def _session(out: Path, sample: DemoSample) -> Path:
    return out / sample.name.lower().replace(" ", "-")


class _Capture:
    """A running `gonio capture` of one material, in a process of its own."""

    def __init__(self, out: Path, sample: DemoSample, poses: Sequence[Pose], rig: str) -> None:
        plan, session = out / f"{_session(out, sample).name}.toml", _session(out, sample)
        _write_plan(plan, sample, poses)
        say(f"gonio capture {plan} --rig {rig} --out {session}")
        self._name = sample.name
        self._process = subprocess.Popen(
            [sys.executable, "-m", "gonio.cli", "capture", str(plan), "--rig", rig, "--out", str(session)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )

    def __enter__(self) -> _Capture:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for its end, which a failure on our side brings about."""
        if kind is not None and kind is not KeyboardInterrupt:
            self._process.terminate()
        try:
            code = self._process.wait()
        except KeyboardInterrupt:
            # It has heard Ctrl-C too and is putting the machine to rest.
            self._process.wait()
            raise
        if code == EXIT_INTERRUPTED and kind is None:
            raise KeyboardInterrupt
        if code and kind is None:
            raise DeviceLost(
                f"the capture of {self._name} ended with code {code}",
                where="demo",
                todo="see its own message above",
            )


def _write_plan(path: Path, sample: DemoSample, poses: Sequence[Pose]) -> None:
    from capture.plan import Darks, Exposure, Head, Plan, PoseList, dump_plan

    plan = Plan(
        plan=Head(name=sample.name, sample=sample.station),
        exposure=Exposure(snr=30.0),
        darks=Darks(count=8),
        poses=(PoseList(directions_deg=tuple(poses)),),
    )
    dump_plan(plan, path)


def _reduce(sample: DemoSample, folder: Path) -> tuple[xr.Dataset, int]:
    from analysis.reduce import reduce_session
    from analysis.samples import write
    from capture.session import Session

    with Session.open(folder) as session:
        poses = len(session.poses("sample"))
        samples = reduce_session(session, progress=Progress(f"reducing {sample.name}, pose", poses))
    write(samples, folder / "samples.nc")
    return samples, poses


def _write_report(out: Path, measured: Sequence[Measured]) -> Path:
    from analysis.report import write_report
    from capture.session import Session
    from gonio.page import machine_facts

    with Session.open(measured[0].session) as session:
        facts = machine_facts(session.rig)
    path = out / "report.html"
    write_report(
        path,
        "Three materials, measured on the twin",
        [entry.measurement() for entry in measured],
        lead=(
            "Each was captured over the wires of a simulated gonioreflectometer, reduced against a white, "
            "and fitted; the true parameters are those the twin was given."
        ),
        facts=facts,
    )
    return path


def _print_tables(measured: Sequence[Measured], result: Mapping[str, Any]) -> None:
    from analysis.figures import channel_names
    from analysis.table import parameter_rows, text_table

    for entry in measured:
        rows = parameter_rows(entry.fitted, channel_names(entry.samples), entry.truth)
        print(f"\n{entry.sample.name} ({entry.sample.model}, {entry.poses} poses)")
        print(text_table(rows))
    print(f"\n{result['poses']} poses in {result['seconds']:.0f} s; report: {result['report']}")
