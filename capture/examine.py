"""Looking at a frame once: its facts for the hot folder, its statistics for the journal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture.raw import read_raw
from capture.statistics import FrameStatistics, frame_statistics, thinned
from rig.errors import BadInput, Refused
from rig.pixels import pixel_geometry

if TYPE_CHECKING:
    from pathlib import Path

    from capture.raw import FrameInfo, RawFrame
    from capture.sensor import SensorModel
    from rig.description import Rig
    from rig.pixels import BoolArray


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """Which camera made a frame."""

    serial: str | None
    model: str | None
    width_px: int
    height_px: int


class Examiner:
    """Reads frames of one machine; a frame that was inspected is not decoded again for its statistics.

    Parameters
    ----------
    rig : Rig
    sensor : SensorModel, optional
        Its calibration.
    """

    def __init__(self, rig: Rig, sensor: SensorModel | None) -> None:
        self._rig, self._sensor = rig, sensor
        self._last: RawFrame | None = None
        self._region: tuple[tuple[float, ...], BoolArray] | None = None

    def inspect(self, path: Path) -> FrameInfo:
        """Tell what a frame says of itself; the whole file is decoded.

        Raises
        ------
        BadInput
            It does not decode (yet).
        """
        self._last = read_raw(path)
        return self._last.info

    def camera(self, path: Path) -> CameraFacts:
        """Tell which camera made a frame.

        Raises
        ------
        BadInput
            The file does not decode.
        """
        info = self._read(path).info
        return CameraFacts(info.camera_serial, info.camera_model, info.width_px, info.height_px)

    def shot_of(self, path: Path) -> str | None:
        """Give the name of the shot that a file carries; None where it carries none or does not decode."""
        try:
            return read_raw(path).shot_id
        except BadInput:
            return None

    def statistics(self, path: Path, angles_rad: tuple[float, ...]) -> FrameStatistics:
        """Tell what a frame shows of the sample.

        Parameters
        ----------
        path : Path
        angles_rad : tuple of float
            Where the arms stood: it tells which pixels see the sample.

        Raises
        ------
        BadInput
            The file does not decode.
        Refused
            It is not of the size that the rig file says.
        """
        frame = self._read(path)
        camera = self._rig.camera
        height_px, width_px = frame.counts.shape
        if (height_px, width_px) != (camera.height_px, camera.width_px):
            raise Refused(
                f"a frame of {width_px} x {height_px} pixels, the rig file says "
                f"{camera.width_px} x {camera.height_px}",
                where=str(path),
                todo="correct camera.width_px and height_px in the rig file, or the camera's settings",
            )
        small, rows, cols = thinned(frame)
        if self._region is None or self._region[0] != angles_rad:
            region = pixel_geometry(self._rig, angles_rad, rows=rows, cols=cols).on_sample
            self._region = (angles_rad, region)
        return frame_statistics(small, self._region[1], self._sensor)

    def _read(self, path: Path) -> RawFrame:
        if self._last is None or self._last.path != path:
            self._last = read_raw(path)
        return self._last
