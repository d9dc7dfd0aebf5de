"""The images of a session: each pose's frames read, merged, and paired with the white."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from analysis.corrections import straightened
from analysis.measurement import Image, Mosaic, PoseImages
from analysis.stray_images import neighbour_weights, put_together
from capture.raw import read_raw
from capture.session_merge import SessionMerger
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.raw import RawFrame
    from capture.session import FrameRecord, PoseRecord, Session


@dataclass(frozen=True)
class PosePair:
    """The records of one pose.

    Attributes
    ----------
    sample, white : PoseRecord
        Frames of the sample, and of the white to divide by.
    """

    sample: PoseRecord
    white: PoseRecord


class SessionImages:
    """Merged images of an opened session.

    Parameters
    ----------
    session : Session
        The session; its calibration, darks and frames are read when asked for.
    straight : bool
        Whether the sensor's bent response is taken out, where its calibration has found one.

    Raises
    ------
    BadInput
        By its methods: for a session without complete poses, or frames that cannot be read.
    """

    def __init__(self, session: Session, *, straight: bool = True) -> None:
        self.session = session
        sensor = session.sensor
        self._bend = sensor.response if straight and sensor is not None else None
        self._merger = SessionMerger(session)
        self._records = session.poses()

    def pairs(self) -> list[PosePair]:
        """Pair each complete pose of the sample with the white at the same pose, in the plan's order."""
        by_role = {role: self._by_index(role) for role in ("sample", "white")}
        pairs = [
            PosePair(record, by_role["white"][index])
            for index, record in sorted(by_role["sample"].items())
            if index in by_role["white"]
        ]
        if not pairs:
            found = ", ".join(f"{len(records)} {role}" for role, records in by_role.items())
            raise BadInput(
                f"no pose has both sample and white ({found})",
                where=str(self.session.folder),
                todo="finish it with gonio capture --resume, or plan it with its white",
            )
        return pairs

    def load(self, pair: PosePair) -> PoseImages:
        """Read and merge the frames of a pair."""
        sample, white = self.image(pair.sample), self.image(pair.white)
        trap, u_trap = self._trap(sample.angles_rad)
        return PoseImages(sample, white, trap, u_trap)

    def _trap(self, at_rad: NDArray[np.float64]) -> tuple[Image | None, float]:
        """Give the light trap's image at a pose, or one put together of the nearest; None without any."""
        records = self._traps
        if not records:
            return None, 0.0
        chosen, weights = neighbour_weights(at_rad, np.array([record.angles_rad for record in records]))
        images = [self.image(records[index]) for index in chosen]
        return (images[0], 0.0) if len(images) == 1 else put_together(images, weights, at_rad)

    @cached_property
    def _traps(self) -> list[PoseRecord]:
        by_index = self._by_index("trap")
        return [by_index[index] for index in sorted(by_index)]

    def image(self, record: PoseRecord) -> Image:
        """Read and merge the frames of one record."""
        frames = sorted(
            (frame for frame in record.frames if frame.lit), key=lambda f: (f.exposure_s, f.shot_id)
        )
        merged = self._merger.merge(record).merged
        radiance = np.asarray(merged.radiance, dtype=np.float64)
        variance = np.asarray(merged.variance, dtype=np.float64)
        if self._bend is not None:
            more = straightened(radiance, [frame.exposure_s for frame in frames], self._bend)
            radiance, variance = radiance * more, variance * more**2
        return Image(
            radiance,
            variance,
            merged.flags,
            np.asarray(record.angles_rad, dtype=np.float64),
            self._lamp_output(frames),
        )

    def _lamp_output(self, frames: Sequence[FrameRecord]) -> float:
        """Light of a merge: long frames count for more in it, nearly as their exposures do."""
        outputs = [self.session.lamp_outputs.get(frame.shot_id, math.nan) for frame in frames]
        return float(np.average(outputs, weights=[frame.exposure_s for frame in frames]))

    def mosaic(self) -> Mosaic:
        """Give the colour filter of the session's camera, from its first frame."""
        frame = self._first_frame
        return Mosaic.repeat(frame.cfa, frame.channels, frame.counts.shape)

    def arm_ticks(self, record: PoseRecord) -> tuple[int, ...]:
        """Give the encoder positions of the arms' joints, in the order of `rig.arm_joints`."""
        rig = self.session.rig
        return tuple(record.ticks[rig.joint_index(joint.name)] for joint in rig.arm_joints)

    def exposures(self) -> dict[str, list[float]]:
        """Give all exposure times by pass, seconds."""
        times: dict[str, list[float]] = {}
        for record in self._records:
            times.setdefault(str(record.role), []).extend(frame.exposure_s for frame in record.frames)
        return times

    def provenance(self) -> dict[str, str]:
        """Give what the samples were made from: hashes of rig and frames, and gonio's version.

        The frames' hash is over their own hashes in the order of passes and poses, so that it is the same for
        an interrupted and an uninterrupted session with the same frames.
        """
        digest = hashlib.sha256()
        for record in sorted(self._records, key=lambda r: (str(r.role), r.index)):
            for frame in sorted(record.frames, key=lambda f: (f.exposure_s, f.shot_id)):
                digest.update(f"{record.role} {record.index} {frame.sha256}\n".encode())
        return {
            "rig_hash": self.session.rig.hash,
            "frames_sha256": digest.hexdigest(),
            "gonio_version": version("gonio"),
        }

    @cached_property
    def _first_frame(self) -> RawFrame:
        return read_raw(self.pairs()[0].sample.frames[0].path)

    def _by_index(self, role: str) -> dict[int, PoseRecord]:
        return {record.index: record for record in self._records if record.role == role and record.frames}
