"""What can befall a frame between the camera and the hot folder."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from simulator.faults import FaultKind

if TYPE_CHECKING:
    from pathlib import Path

    from simulator.frames import FrameMaker
    from simulator.request import FrameRequest

CUT = 0.6
"""Share of a truncated file that arrives."""


class FaultyCamera:
    """A camera whose files may come late, damaged, twice, in another order, or not at all.

    Parameters
    ----------
    maker : FrameMaker
        Makes the files.
    """

    def __init__(self, maker: FrameMaker) -> None:
        self._maker = maker
        self._held: Path | None = None

    def deliver(self, request: FrameRequest, fault: dict[str, Any] | None) -> str:
        """Make the file of one exposure and let the fault have it.

        Parameters
        ----------
        request : FrameRequest
        fault : dict or None
            `kind`, `for_s` and `factor` of the fault, as `simulator.faults.Fault` has them.

        Returns
        -------
        str
            The file's path in the hot folder, or what became of it.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        if fault is None:
            path = str(self._maker.make(request))
        else:
            path = self._befall(request, FaultKind(fault["kind"]), fault["for_s"], fault["factor"])
            if fault["kind"] == FaultKind.FILE_OUT_OF_ORDER:
                return path  # after the next one
        self._release()
        return path

    def _befall(self, request: FrameRequest, kind: FaultKind, for_s: float, factor: float) -> str:
        match kind:
            case FaultKind.NO_FILE:
                return "never written"
            case FaultKind.FILE_OUT_OF_ORDER:
                self._release()
                self._held = self._maker.make(request, hidden=True)
                return "held back"
            case FaultKind.LATE_FILE:
                time.sleep(for_s)
                return str(self._maker.make(request))
            case FaultKind.FILE_TWICE:
                self._maker.make(request)
            case FaultKind.WRONG_EXPOSURE:
                times = (request.exposure_s * factor, request.shutter_open_s * factor)
                request = replace(request, exposure_s=times[0], shutter_open_s=times[1])
        path = self._maker.make(request, hidden=kind in {FaultKind.TRUNCATED_FILE, FaultKind.DISK_FULL})
        if kind is FaultKind.CLOCK_STEP:
            stepped = path.stat().st_mtime + for_s
            os.utime(path, (stepped, stepped))
        elif kind in {FaultKind.TRUNCATED_FILE, FaultKind.DISK_FULL}:
            length = int(path.stat().st_size * CUT) if kind is FaultKind.TRUNCATED_FILE else 0
            os.truncate(path, length)
            path = _show(path)
        return str(path)

    def _release(self) -> None:
        """Let a file that was held back come now."""
        if self._held is not None:
            _show(self._held)
            self._held = None


def _show(hidden: Path) -> Path:
    """Give a hidden file its name."""
    return hidden.rename(hidden.with_name(hidden.name.removeprefix(".")))
