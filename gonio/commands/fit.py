"""Fit reflectance models to BRDF samples of any laboratory: parameters with uncertainty, goodness of fit.

FILE is a session's folder, a gonio NetCDF or CSV table, a Cornell .brdf, an RT-300S .xls or an .npz of wi,
wo, f_r; its content tells. Without --model the six usual models are fitted, with --all every model, and
ranked by rms_log. Without --wavelength-nm all channels of a file share the shape parameters; kd and ks are
each channel's own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gonio.output import Progress, add_json_option, print_json
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    import xarray as xr

    from analysis.fit import FitResult

EXAMPLE = "gonio fit ../shared/data/cornell/garnet_red.brdf --wavelength-nm 550 --model cook-torrance"

METRICS = {
    "rms_log": "rms_log",
    "l2_cos": "l2_cos",
    "rms_cbrt": "rms_cbrt",
    "median_relative": "median rel.",
    "chi2_dof": "chi2/dof",
}
MOST_CHANNELS_SHOWN = 4


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `gonio fit`."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="samples to fit")
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--model",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="models to fit (default: the six usual ones, ranked)",
    )
    which.add_argument("--all", action="store_true", help="fit every model there is")
    parser.add_argument(
        "--wavelength-nm",
        nargs="+",
        type=float,
        action="extend",
        metavar="W",
        help="channels to fit together",
    )
    parser.add_argument(
        "--blank", metavar="FILE", help="RT-300S: the measurement without a sample, subtracted"
    )
    parser.add_argument(
        "--loss",
        metavar="NAME",
        help="chi2, log, cbrt or l2 (default: chi2 where uncertainties exist, else log)",
    )
    parser.add_argument(
        "--max-theta-deg", type=float, metavar="T", help="leave out samples beyond this angle"
    )
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Fit and print; see the module's description."""
    from analysis.models import DEFAULT_MODELS, FITTED_MODELS, MODELS
    from analysis.samples import read, select

    usual = FITTED_MODELS if options.all else DEFAULT_MODELS
    names = list(dict.fromkeys(options.model or usual))
    _check_names(names, list(MODELS))
    progress = Progress("fits", len(options.files) * len(names))
    entries = []
    for file in options.files:
        samples = select(
            read(file, blank=options.blank),
            wavelength_nm=options.wavelength_nm,
            max_theta_deg=options.max_theta_deg,
            where=file,
        )
        results = _fit_all(file, samples, names, options.loss, progress)
        if options.json:
            entries += [_entry(file, samples, result) for result in results]
        else:
            print(_page(file, samples, results))
    if options.json:
        print_json({"fits": entries})
    return 0


def _check_names(names: Sequence[str], known: Sequence[str]) -> None:
    """Refuse before anything is read."""
    from pathlib import Path

    for name in names:
        if name not in known:
            todo = f"choose from {', '.join(known)}"
            if Path(name).exists():
                todo = "write the files before --model"
            raise BadInput(f"unknown model '{name}'", where="--model", todo=todo)


def _fit_all(
    file: str, samples: xr.Dataset, names: Sequence[str], loss: str | None, progress: Progress
) -> list[FitResult]:
    """Fit each model; best first."""
    from analysis.fit import fit

    results = []
    for name in names:
        try:
            results.append(fit(samples, name, loss=loss))
        except BadInput as error:
            raise BadInput(str(error), where=file) from None
        progress(note=name)
    return sorted(results, key=lambda result: result.metrics["rms_log"])


def _entry(file: str, samples: xr.Dataset, result: FitResult) -> dict[str, Any]:
    """Describe one fit for scripts; a parameter that channels do not share is a list by channel."""
    return {
        "file": file,
        "model": result.model.NAME,
        "loss": result.loss,
        "channels": [str(channel) for channel in samples["channel"].to_numpy()],
        "count": result.count,
        "parameters": {
            name: {"value": value, "u": result.u[name]} for name, value in result.parameters.items()
        },
        "derived": {name: {"value": value, "u": u} for name, (value, u) in result.derived.items()},
        "metrics": result.metrics,
        "condition": result.condition,
        "message": result.message,
    }


def _page(file: str, samples: xr.Dataset, results: Sequence[FitResult]) -> str:
    """Set one file's fits for people: the ranking, then each model's parameters."""
    channels = [str(channel) for channel in samples["channel"].to_numpy()]
    first = results[0]
    shown = [name for name in METRICS if name in first.metrics]
    lines = [f"{file}: {first.count} data in {len(channels)} channel(s), loss {first.loss}", ""]
    lines.append(f"{'model':<20}" + "".join(f"{METRICS[name]:>13}" for name in shown))
    for result in results:
        cells = "".join(f"{result.metrics[name]:>13.5g}" for name in shown)
        lines.append(f"{result.model.NAME:<20}{cells}")
    for result in results:
        lines += ["", *_parameters(result, channels)]
    return "\n".join([*lines, ""])


def _parameters(result: FitResult, channels: Sequence[str]) -> list[str]:
    """Set a model's parameters, value and standard uncertainty; many channels become a range."""
    import numpy as np

    from analysis.table import rounded

    lines = [f"{result.model.NAME}  (value, standard uncertainty)"]
    numbers = {name: (value, result.u[name]) for name, value in result.parameters.items()} | result.derived
    for name, (values, us) in numbers.items():
        if values.ndim == 0:
            lines.append(_number_line(name, *rounded(float(values), float(us))))
        elif values.size <= MOST_CHANNELS_SHOWN:
            labels = [f"{name} {channel}" for channel in channels]
            lines += [
                _number_line(label, *rounded(float(value), float(u)))
                for label, value, u in zip(labels, values, us, strict=True)
            ]
        else:
            largest = f"u <= {np.max(us):.2g}"
            span = f"{values.min():.4g} to {values.max():.4g}"
            lines.append(f"  {name:<14} {span} over {values.size} channels, {largest}")
    if result.message:
        lines.append(f"  note: {result.message}")
    return lines


def _number_line(label: str, value: str, u: str) -> str:
    return f"  {label:<14} {value:>12}  {u or 'not determined':>10}"
