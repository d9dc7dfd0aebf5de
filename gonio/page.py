"""From a session to what its page shows: fits, the frame worth showing, the rendered sphere, provenance."""

from __future__ import annotations

import io
import platform
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from analysis.fit import fit
from analysis.models import DEFAULT_MODELS, MODELS
from analysis.report import Measurement, ShownFrame
from analysis.session_images import SessionImages
from capture.interruptions import INTERRUPTIONS, REFERENCE, holes, interruptions
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import xarray as xr
    from numpy.typing import ArrayLike

    from analysis.fit import FitResult
    from analysis.models.base import Model
    from capture.session import Session
    from rig.description import Rig

SPHERE_PX = 360
VERSIONS = ("gonio", "numpy", "scipy", "mitsuba", "bluesky")


def fit_models(samples: xr.Dataset, names: Sequence[str] | None) -> list[FitResult]:
    """Fit the models asked for, in that order; by default the usual ones that differ, best first by rms_log.

    Raises
    ------
    BadInput
        For a model that does not exist, or samples that cannot determine one.
    """
    for name in names or ():
        if name not in MODELS:
            raise BadInput(
                f"unknown model '{name}'", where="--model", todo=f"choose from {', '.join(MODELS)}"
            )
    if names:
        return [fit(samples, name) for name in dict.fromkeys(names)]
    # Models that differ by a constant tie but for rounding: of those the last, the modern form, stands.
    fits = (fit(samples, name) for name in DEFAULT_MODELS)
    distinct = {f"{fitted.metrics['rms_log']:.6g}": fitted for fitted in fits}
    return sorted(distinct.values(), key=lambda fitted: fitted.metrics["rms_log"])


def measurement_of(
    session: Session,
    samples: xr.Dataset,
    fits: Sequence[FitResult],
    *,
    title: str = "",
    truth: Mapping[str, ArrayLike] | None = None,
    facts: Mapping[str, str] | None = None,
) -> Measurement:
    """Collect what a page shows of one session.

    Parameters
    ----------
    session : Session
        The opened session.
    samples : Dataset
        Its samples.
    fits : sequence of FitResult
        Models fitted to them, the one to discuss first.
    title : str
        The sample's name; by default the session's.
    truth : mapping of str to float or (C,), optional
        True parameters of the first model, where known.
    facts : mapping of str to str, optional
        What else is known of it, shown before the session's own.
    """
    images = SessionImages(session)
    return Measurement(
        title=title or session.name,
        samples=samples,
        fits=fits,
        truth=truth,
        frame=_frame_to_show(session, samples, images),
        sphere_png=sphere_png(fits[0].model) if fits else None,
        exposure_s=images.exposures(),
        facts=dict(facts or {}) | session_facts(session, samples),
    )


def sphere_png(model: Model) -> bytes:
    """Render a sphere of a fitted model, lit by a small lamp and a dim sky, on white; as PNG."""
    from colour import cctf_encoding
    from matplotlib.image import imsave

    from simulator.sphere import render_sphere

    parameters = {parameter.name: getattr(model, parameter.name) for parameter in model.PARAMETERS}
    # One small picture is as fast without a compiler, and looks the same on every machine.
    linear = render_sphere(
        model.NAME, SPHERE_PX, parameters=_three_channels(parameters), variant="scalar", background=1.0
    )
    encoded = np.clip(cctf_encoding(np.clip(linear, 0.0, 1.0), "sRGB"), 0.0, 1.0)
    buffer = io.BytesIO()
    imsave(buffer, encoded, format="png", metadata={"Software": "gonio"})
    return buffer.getvalue()


def machine_facts(rig: Rig) -> dict[str, str]:
    """Name the machine and the software, for the page's head."""
    lamp, camera = rig.lamp, rig.camera
    return {
        "Machine": rig.name,
        "Rig hash": rig.hash,
        "Lamp": f"{lamp.distance_mm:g} mm away, {lamp.diameter_mm:g} mm wide, exposure timed by {lamp.mode}",
        "Camera": (
            f"{camera.width_px} × {camera.height_px} pixels, {camera.distance_mm:g} mm away, pupil "
            f"{camera.aperture_diameter_mm:g} mm, serial {camera.serial or 'not stated'}"
        ),
        "White": f"ρ = {rig.white.rho:g}, u = {rig.white.u_rho:g}, Lambertian",
        "Versions": ", ".join(f"{name} {version(name)}" for name in VERSIONS)
        + f", Python {platform.python_version()}",
    }


def session_facts(session: Session, samples: xr.Dataset) -> dict[str, str]:
    """Say what was measured, when, and from which frames."""
    facts = {"Session": session.name}
    for title, key in (("Measured", "created"), ("Operator", "operator")):
        if session.facts.get(key):
            facts[title] = str(session.facts[key])
    poses = np.unique(samples["pose"].to_numpy()).size
    facts["Extent"] = (
        f"{poses} poses, {samples.sizes['sample']} direction pairs, {samples.sizes['channel']} channels"
    )
    facts["Solid angles"] = (
        f"source {samples.attrs['source_solid_angle_sr']:.3g} sr, "
        f"receiver {samples.attrs['receiver_solid_angle_sr']:.3g} sr"
    )
    left_out = str(samples.attrs.get("option_without", ""))
    if left_out:
        facts["Not corrected"] = left_out.replace(",", ", ")
    facts |= interruption_facts(session)
    facts["SHA-256 of the frames"] = str(samples.attrs.get("frames_sha256", "not recorded"))
    return facts


def interruption_facts(session: Session) -> dict[str, str]:
    """Say what did not go straight: interruptions, steps at reference poses, poses that are missing."""
    counts = interruptions(session.journal)
    told = [f"{INTERRUPTIONS[kind]}: {count}" for kind, count in counts.items()]
    facts = {"Interruptions": ", ".join(told) or "none"}
    again = [event.detail for event in session.events() if event.kind == REFERENCE]
    steps = [abs(ratio - 1.0) for detail in again for ratio in detail["ratio"]]
    if steps:
        asked = sum("predicted" in detail for detail in again)
        because = f" ({asked} because of drift)" if asked else ""
        facts["Reference poses"] = (
            f"shot again {len(again)} times{because}, light within {max(steps):.2%} of what it was"
        )
    missing = [f"{hole.role} {hole.pose} ({hole.reason})" for hole in holes(session.journal)]
    if missing:
        facts["Missing poses"] = "; ".join(missing)
    drifts = [abs(row.lamp_drift - 1.0) for row in session.journal.levels() if row.lamp_drift is not None]
    if drifts:
        facts["Lamp"] = f"within {max(drifts):.2%} of the first pose, by its monitor"
    return facts


def _three_channels(parameters: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    """Fit parameters to a picture's three channels: the first channel alone where there are not three."""
    return {
        name: value if np.size(value) in {1, 3} else float(np.atleast_1d(np.asarray(value))[0])
        for name, value in parameters.items()
    }


def _frame_to_show(session: Session, samples: xr.Dataset, images: SessionImages) -> ShownFrame:
    """Choose a pose of several exposures whose samples fill the image and differ much: a lobe crosses it."""
    pairs = {pair.sample.index: pair.sample for pair in images.pairs()}
    pose = samples["pose"].to_numpy()
    value = np.nanmean(np.where(np.isfinite(samples["f_r"]), samples["f_r"], np.nan), axis=1)
    interest = {}
    for index, record in pairs.items():
        seen = value[pose == index]
        if seen.size > 20:
            low, middle, high = np.percentile(seen, [5, 50, 95])
            exposures = len({frame.exposure_s for frame in record.frames})
            interest[index] = (high - low) / max(abs(middle), 1e-9) * seen.size**2 * exposures**2
    best = max(interest, key=lambda index: interest[index]) if interest else min(pairs)
    chosen = pairs[best]
    times = sorted({frame.exposure_s for frame in chosen.frames if frame.lit})
    angles = ", ".join(
        f"{joint.name.replace('_', ' ')} {np.rad2deg(angle):.2f}°"
        for joint, angle in zip(session.rig.arm_joints, chosen.angles_rad, strict=True)
    )
    caption = f"Pose {best} ({angles}), merged from {_listed(times)} s"
    return ShownFrame(images.image(chosen), images.mosaic().channel, caption)


def _listed(times: Sequence[float]) -> str:
    texts = [f"{time:.3g}" for time in times]
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}"
