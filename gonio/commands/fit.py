"""Fit reflectance models to BRDF samples of any laboratory: parameters with uncertainty, goodness of fit.

FILE is a session's folder or a file in any format of docs/formats.md; its content tells which. Without
--model the six usual models are fitted, with --all every model. They are ranked by cross-validation: the
residual, in the loss's own measure, at incidences that were left out of the fit; where there is one
incidence, by BIC. With --compare several files are set side by side. Without --wavelength-nm all channels of
a file share the shape parameters; kd and ks are each channel's own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gonio.output import Progress, add_json_option, print_json
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    import xarray as xr

    from analysis.comparison import Candidate
    from analysis.fit import FitResult

EXAMPLE = "gonio fit garnet_red.brdf --wavelength-nm 550 --model cook-torrance"

METRICS = {
    "rms_log": "rms_log",
    "l2_cos": "l2_cos",
    "rms_cbrt": "rms_cbrt",
    "median_relative": "median rel.",
    "chi2_dof": "chi2/dof",
}
MOST_CHANNELS_SHOWN = 4
DIFFERENT = 3.0
"""Difference of two files over its standard uncertainty that is marked."""


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
    parser.add_argument("--compare", action="store_true", help="set each parameter of all files side by side")
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Fit and print; see the module's description."""
    from analysis.models import DEFAULT_MODELS, FITTED_MODELS, MODELS
    from analysis.samples import read, select

    usual = FITTED_MODELS if options.all else DEFAULT_MODELS
    names = list(dict.fromkeys(options.model or usual))
    _check_names(names, list(MODELS))
    if options.compare and len(options.files) < 2:
        raise BadInput("there is one file", where="--compare", todo="name the files to compare")
    progress = Progress("fits", len(options.files) * len(names))
    ranked: dict[str, list[Candidate]] = {}
    entries = []
    for file in options.files:
        samples = select(
            read(file, blank=options.blank),
            wavelength_nm=options.wavelength_nm,
            max_theta_deg=options.max_theta_deg,
            where=file,
        )
        ranked[file] = _compared(file, samples, names, options.loss, progress)
        channels = [str(channel) for channel in samples["channel"].to_numpy()]
        if options.json:
            entries += [_entry(file, channels, candidate) for candidate in ranked[file]]
        elif not options.compare:
            print(_page(file, channels, ranked[file]))
    rows = _side_by_side(ranked) if options.compare else []
    if options.json:
        print_json({"fits": entries, **({"comparison": rows} if options.compare else {})})
    elif options.compare:
        print(_comparison(list(ranked), rows))
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


def _compared(
    file: str, samples: xr.Dataset, names: Sequence[str], loss: str | None, progress: Progress
) -> list[Candidate]:
    """Fit and judge each model; best first."""
    from analysis.comparison import compare

    try:
        return compare(samples, names, loss=loss, told=lambda name: progress(note=name))
    except BadInput as error:
        raise BadInput(str(error), where=file) from None


def _entry(file: str, channels: Sequence[str], candidate: Candidate) -> dict[str, Any]:
    """Describe one fit for scripts; a parameter that channels do not share is a list by channel."""
    from analysis.intervals import profile_intervals

    result = candidate.result
    intervals = profile_intervals(result, scales=len(channels) <= MOST_CHANNELS_SHOWN)
    return {
        "file": file,
        "model": result.model.NAME,
        "loss": result.loss,
        "channels": list(channels),
        "count": result.count,
        "parameters": {
            name: {"value": value, "u": result.u[name], "interval_95": intervals.get(name)}
            for name, value in result.parameters.items()
        },
        "derived": {name: {"value": value, "u": u} for name, (value, u) in result.derived.items()},
        "metrics": result.metrics | _appearance(result),
        "cross_validation": candidate.cross_validation,
        "bic": candidate.bic,
        "condition": result.condition,
        "correlation": {
            "of": [name if c is None else f"{name} {channels[c]}" for name, c in result.names],
            "matrix": result.correlation,
        },
        "cautions": [
            {"kind": each.kind.value, "parameters": each.parameters, "text": each.text}
            for each in result.cautions
        ],
        "message": result.message,
    }


def _appearance(result: FitResult) -> dict[str, float]:
    """Compare model and samples by albedo and the colours of a sphere."""
    import numpy as np

    from analysis.appearance import appearance

    geometry, loss = result.state.problem.geometry, result.state.loss
    f_r = np.where(loss.used, loss.data, np.nan)
    return appearance(result.model.evaluate, geometry.wi, geometry.wo, f_r)


def _page(file: str, channels: Sequence[str], ranked: Sequence[Candidate]) -> str:
    """Set one file's fits for people: the ranking, what it means, then each model's parameters."""
    from analysis.comparison import in_words

    first = ranked[0].result
    shown = [name for name in METRICS if name in first.metrics]
    lines = [f"{file}: {first.count} data in {len(channels)} channel(s), loss {first.loss}", ""]
    heads = ["cross-val.", "BIC", *(METRICS[name] for name in shown)]
    lines.append(f"{'model':<22}" + "".join(f"{head:>13}" for head in heads))
    for each in ranked:
        metrics = [each.result.metrics[name] for name in shown]
        cells = "".join(f"{value:>13.5g}" for value in (each.cross_validation, each.bic, *metrics))
        lines.append(f"{each.name:<22}{cells}")
    words = in_words(ranked)
    if words:
        lines += ["", words]
    for each in ranked:
        lines += ["", *_parameters(each.result, channels)]
    return "\n".join([*lines, ""])


def _side_by_side(ranked: dict[str, list[Candidate]]) -> list[dict[str, Any]]:
    """Set each parameter of each model over the files, with the largest difference in its own u."""
    import numpy as np

    rows = []
    names = [each.name for each in next(iter(ranked.values()))]
    for name in names:
        results = [next(c.result for c in each if c.name == name) for each in ranked.values()]
        if len({len(result.names) for result in results}) > 1:
            raise BadInput(
                "the files have different numbers of channels", where="--compare", todo="choose some"
            )
        for row, (parameter, channel) in enumerate(results[0].names):
            values = np.array([np.ravel(r.parameters[parameter])[channel or 0] for r in results])
            u = np.sqrt([r.covariance[row, row] for r in results])
            difference = np.abs(values[:, None] - values[None])
            spread = np.hypot(u[:, None], u[None])
            pull = np.max(np.where(spread > 0.0, difference / np.where(spread > 0.0, spread, 1.0), 0.0))
            rows.append(
                {
                    "model": name,
                    "parameter": parameter,
                    "channel": channel,
                    "values": values,
                    "u": u,
                    "largest_difference_in_u": float(pull),
                }
            )
    return rows


def _comparison(files: Sequence[str], rows: Sequence[dict[str, Any]]) -> str:
    """Set the files side by side for people."""
    from analysis.table import rounded

    lines = [f"[{number}] {file}" for number, file in enumerate(files, start=1)]
    model = ""
    for row in rows:
        if row["model"] != model:
            model = row["model"]
            heads = "".join(f"{f'[{number}]':>24}" for number in range(1, len(files) + 1))
            lines += ["", f"{model:<16}{heads}{'difference / u':>18}"]
        label = row["parameter"] if row["channel"] is None else f"{row['parameter']} {row['channel'] + 1}"
        cells = ""
        for value, u in zip(row["values"], row["u"], strict=True):
            number, spread = rounded(float(value), float(u))
            cells += f"{f'{number} +- {spread}' if spread else f'{number} (open)':>24}"
        mark = "  differs" if row["largest_difference_in_u"] > DIFFERENT else ""
        lines.append(f"  {label:<14}{cells}{row['largest_difference_in_u']:>18.3g}{mark}")
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
