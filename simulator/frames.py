"""Exposures to DNG files in the hot folder: light, sensor, file."""

from __future__ import annotations

import json
import math
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simulator.dng import DngMeta, exact_seconds, write_dng
from simulator.light.renderer import Renderer
from simulator.materials import ClosedFormMaterial
from simulator.sensor import RGGB, Sensor, derived_seed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rig.description import Rig
    from simulator.materials import Material
    from simulator.request import FrameRequest

NAMELESS_SERIAL = "TWIN-0001"
"""Serial number of the camera where the rig file asks for none."""

PIXEL_PITCH_MM = Fraction(1, 50)
"""Turns the rig file's focal length in pixels into the millimetres that a DNG states."""


class FrameMaker:
    """Makes the picture of any exposure; the twin's camera.

    Made, it has written `calibration/sensor.toml` and, for tests, `truth.json` beside the rig file, and is as
    fast at its first frame as at any other.

    Parameters
    ----------
    rig : Rig
        The machine.
    materials : mapping of str to (str or Material)
        What lies at its sample stations; see `simulator.materials`. A machine without a wheel shows the first
        of them.
    seed : int
        The twin's seed: it draws the camera's pixels and the true albedos of white and light trap.
    folder : path, optional
        The hot folder, made where it is missing; by default the rig file's `ports.frames`.
    variant : str, optional
        Variant of Mitsuba; by default the fastest that can run.
    housing_albedo : float, optional
        Albedo of the housing; 0 is black surroundings; by default what the rig file says.
    tolerance : float, optional
        Error of the light that is allowed, relative to the mean radiance over the sample;
        likewise.
    bits : int
        Depth of the camera's converter, 14 or 12.

    Raises
    ------
    BadInput
        A material is wrong, or a variant that does not exist is asked for.
    OSError
        A file cannot be written.
    """

    def __init__(
        self,
        rig: Rig,
        materials: Mapping[str, str | Material],
        seed: int,
        *,
        folder: str | Path | None = None,
        variant: str | None = None,
        housing_albedo: float | None = None,
        tolerance: float | None = None,
        bits: int = 14,
    ) -> None:
        self.rig, self.seed = rig, seed
        self.folder = Path(rig.ports.frames if folder is None else folder)
        self.white_rho = true_white_rho(rig, seed)
        self.renderer = Renderer(
            rig,
            materials,
            variant=variant,
            white_rho=self.white_rho,
            trap_rho=true_trap_rho(rig, seed),
            housing_albedo=housing_albedo,
            tolerance=tolerance,
        )
        camera = rig.camera
        serial = camera.serial or NAMELESS_SERIAL
        self.sensor = Sensor(camera.width_px, camera.height_px, serial=serial, seed=seed, bits=bits)
        self._mounted = None if rig.stations else next(iter(materials), None)
        self.folder.mkdir(parents=True, exist_ok=True)
        write_calibration(rig.folder, self.sensor)
        write_truth(rig.folder, seed, self.white_rho, self.renderer.materials)
        self.renderer.prewarm()

    def make(self, request: FrameRequest, *, hidden: bool = False) -> Path:
        """Make the file of one exposure.

        Parameters
        ----------
        request : FrameRequest
            The exposure. Equal requests give equal files, but for the name.
        hidden : bool
            Whether its name begins with a dot: nobody takes it for a picture yet.

        Returns
        -------
        Path
            The file, complete, in the hot folder; `<shot>_<ID>.dng`.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        identity = _identity(request)
        radiance = None
        if request.lit:
            station = request.station or self._mounted
            light = request.level * request.output
            radiance = self.renderer.radiance(station, request.angles_rad, light)
            radiance = radiance + self.rig.twin.stray_light * light / math.pi
        counts = self.sensor.expose(
            radiance,
            request.exposure_s,
            np.random.default_rng(identity),
            shutter_open_s=request.shutter_open_s,
        )
        path = self._new_path(request)
        path = path.with_name(f".{path.name}") if hidden else path
        write_dng(path, counts, self._meta(request, identity))
        return path

    def _new_path(self, request: FrameRequest) -> Path:
        """Return a name that no file has: a camera never writes over a picture."""
        stem = f"{request.shot:06d}_{request.shot_id}" if request.shot_id else f"{request.shot:06d}"
        path, again = self.folder / f"{stem}.dng", 1
        while path.exists():
            again += 1
            path = self.folder / f"{stem}-{again}.dng"
        return path

    def _meta(self, request: FrameRequest, identity: int) -> DngMeta:
        focal_length_mm = (Fraction(self.rig.camera.focal_length_px) * PIXEL_PITCH_MM).limit_denominator(1000)
        aperture_mm = Fraction(self.rig.camera.aperture_diameter_mm).limit_denominator(1000)
        (red, green), (other_green, blue) = RGGB
        return DngMeta(
            shutter_s=exact_seconds(request.shutter_open_s),
            black_dn=self.sensor.black_dn,
            white_dn=int(self.sensor.clip_dn),
            cfa=(red, green, other_green, blue),
            serial=self.sensor.serial,
            f_number=(focal_length_mm / aperture_mm).limit_denominator(1000),
            focal_length_mm=focal_length_mm,
            unique_id=identity.to_bytes(16, "little"),
            description={
                "gonio": 1,
                "shot_id": request.shot_id or None,
                "exposure_s": _decimal(request.exposure_s),
                "shutter_s": _decimal(request.shutter_open_s),
                "mode": request.mode,
                "lit": request.lit,
                "level": request.level,
                "camera_serial": self.sensor.serial,
                "seed": request.seed,
            },
        )


def _identity(request: FrameRequest) -> int:
    """Hash everything that a frame may depend on: neither wall time nor the shot's number are in it."""
    return derived_seed(
        "frame",
        request.seed,
        request.station,
        tuple(sorted(request.ticks.items())),
        float(request.level * request.output),
        float(request.exposure_s),
        float(request.shutter_open_s),
        request.mode,
        request.lit,
        request.shot_id,
    )


def _decimal(seconds: float) -> str:
    """Write a time as the shortest decimal that names the same float, without an exponent."""
    return format(Decimal(repr(float(seconds))), "f")


def true_white_rho(rig: Rig, seed: int) -> float:
    """Draw the white's true albedo: the certificate's, off by what the certificate admits.

    Parameters
    ----------
    rig : Rig
        Its `white` is the certificate.
    seed : int
        The twin's seed.

    Returns
    -------
    float
        At most 1.
    """
    off = np.random.default_rng(derived_seed("white", seed)).standard_normal()
    return float(min(1.0, rig.white.rho + rig.white.u_rho * off))


def true_trap_rho(rig: Rig, seed: int) -> float:
    """Draw the light trap's true albedo: the stated one, off by its uncertainty, at least 0."""
    off = np.random.default_rng(derived_seed("trap", seed)).standard_normal()
    return float(max(0.0, rig.trap.rho + rig.trap.u_rho * off))


def write_calibration(folder: Path, sensor: Sensor) -> Path:
    """Write what a perfect calibration would find.

    Parameters
    ----------
    folder : Path
        Where the rig file lies.
    sensor : Sensor
        The camera's sensor.

    Returns
    -------
    Path
        `calibration/sensor.toml` in that folder; `white.toml` is beside it.
    """
    from analysis.white_calibration import WHITE_FILE, WhiteCalibration, save_white
    from capture.sensor import save_sensor

    path = folder / "calibration" / "sensor.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    save_sensor(sensor.calibration(), path)
    save_white(WhiteCalibration(lambertian=True, note="the twin's white"), path.with_name(WHITE_FILE))
    return path


def write_truth(folder: Path, seed: int, white_rho: float, materials: Mapping[str, Material]) -> Path:
    """Write what only a test may know.

    Parameters
    ----------
    folder : Path
        Where the rig file lies.
    seed : int
        The twin's seed.
    white_rho : float
        True albedo of the white.
    materials : mapping of str to Material
        What lies at each station.

    Returns
    -------
    Path
        `truth.json` in that folder: `{"seed", "white": {"rho"}, "materials": {station: {"spec", "model",
        "parameters": {name: [per channel]}}}}`, without model and parameters where there is no closed form.
    """
    listed = {
        station: {"spec": material.spec}
        | (
            {"model": material.model, "parameters": material.truth}
            if isinstance(material, ClosedFormMaterial)
            else {}
        )
        for station, material in materials.items()
    }
    path = folder / "truth.json"
    truth = {"seed": seed, "white": {"rho": white_rho}, "materials": listed}
    path.write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")
    return path
