"""A session to BRDF samples: merged, divided by the white, put together with their uncertainty.

The physics is in `analysis.measurement`, the bins in `analysis.binning`; here poses are read, merged, reduced
and put together, in the order of the plan, so that a session gives the same table bit for bit however often
it was interrupted and however many threads reduce it.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.colour_calibration import attributes_of
from analysis.corrections import Correction, u_linearity_of
from analysis.measurement import Options, PoseSamples, reduce_pose
from analysis.samples import make_samples
from analysis.session_images import SessionImages
from analysis.white import white_of
from analysis.white_calibration import WHITE_FILE, load_white
from capture.drift import unseen_drift
from capture.records import SPOILED
from capture.session import CALIBRATION_FOLDER
from rig.errors import BadInput
from rig.pixels import receiver_solid_angle_sr, source_solid_angle_sr
from rig.ticks import tick_rad

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import xarray as xr
    from numpy.typing import NDArray

    from analysis.session_images import PosePair
    from analysis.white import WhiteReference
    from capture.session import Session
    from rig.description import Rig

    Float = NDArray[np.float64]

SPOILED_POSE = 16
"""Bit of the samples' `flags`, beside those of `analysis.binning.Dropped`: the values are there, but the plan
knew that a solid shades or hides the sample at their pose, or that the lamp is in the picture."""

THREADS = 2
"""Decoding and merging release the interpreter; more threads than two wait for the disk."""


@dataclass(frozen=True)
class ReducedPose:
    """One pose's samples and what they share with other poses.

    Attributes
    ----------
    number : int
        The pose's number in the plan.
    white_number : int
        The number of the white image it was divided by.
    ticks : (J,) tuple of int
        Encoder positions of the arms' joints.
    samples : PoseSamples
        The samples.
    spoiled : bool
        Whether the plan knew that something is in the way there, or the lamp in the picture.
    """

    number: int
    white_number: int
    ticks: tuple[int, ...]
    samples: PoseSamples
    spoiled: bool = False


def reduce_session(
    session: Session, *, options: Options | None = None, progress: Callable[[], None] | None = None
) -> xr.Dataset:
    """Reduce every pose of a session that has both its sample and its white.

    Parameters
    ----------
    session : Session
        An opened session.
    options : Options, optional
        Bin size, margins.
    progress : callable, optional
        Called after each pose.

    Returns
    -------
    Dataset
        See `analysis.samples`.

    Raises
    ------
    BadInput
        For a session without a complete pose, or with a frame that cannot be read.
    """
    options = options or Options()
    straight = options.corrects(Correction.LINEARITY)
    images = SessionImages(session, straight=straight)
    pairs = images.pairs()
    mosaic = images.mosaic()
    reference = session_white(session, len(mosaic.names))
    u_joint_rad = joint_resolution(session.rig)

    def one(pair: PosePair) -> ReducedPose:
        reduced = reduce_pose(
            session.rig, images.load(pair), mosaic, reference, u_joint_rad=u_joint_rad, options=options
        )
        ticks, spoiled = images.arm_ticks(pair.sample), bool(pair.sample.flags & SPOILED)
        return ReducedPose(pair.sample.index, pair.white.index, ticks, reduced, spoiled)

    poses = []
    with ThreadPoolExecutor(THREADS) as pool:
        for reduced in pool.map(one, pairs):
            poses.append(reduced)
            if progress is not None:
                progress()
    return assemble(
        session.rig,
        poses,
        mosaic.names,
        options=options,
        source=session.name,
        provenance=images.provenance()
        | {"white": reference.name}
        | attributes_of(session.folder / CALIBRATION_FOLDER, mosaic.names),
        u_linearity=u_linearity_of(session.sensor, corrected=straight),
        u_drift=unseen_drift(session.events()) or None,
    )


def session_white(session: Session, channels: int) -> WhiteReference:
    """Give the white of a session: of its own calibration where there is one, else generic.

    Raises
    ------
    BadInput
        A calibration file that cannot be used.
    """
    path = session.folder / CALIBRATION_FOLDER / WHITE_FILE
    return white_of(session.rig, load_white(path) if path.is_file() else None, channels)


def joint_resolution(rig: Rig) -> Float:
    """Give the standard uncertainty of each arm joint's angle from its encoder's step, (J,) radians.

    An even distribution over one step has the standard deviation step / sqrt(12) (GUM, JCGM 100:2008,
    F.2.2.1).
    """
    return np.array([tick_rad(joint) for joint in rig.arm_joints]) / math.sqrt(12)


def assemble(
    rig: Rig,
    poses: Sequence[ReducedPose],
    channels: Sequence[str],
    *,
    options: Options,
    source: str = "",
    provenance: Mapping[str, Any] | None = None,
    u_linearity: float | None = None,
    u_drift: float | None = None,
) -> xr.Dataset:
    """Put the samples of all poses into one table.

    Parameters
    ----------
    rig : Rig
        The machine: solid angles, joints.
    poses : sequence of ReducedPose
        In the order they are to have.
    channels : sequence of str
        Names of the channels.
    options : Options
        How they were reduced, recorded.
    source : str
        Where they come from.
    provenance : mapping of str to attribute, optional
        Hashes and versions, recorded as attributes.
    u_linearity : float, optional
        Relative uncertainty by the sensor's response; None where it is not known.
    u_drift : float, optional
        Relative uncertainty by drift that only references have found; None for none.

    Raises
    ------
    BadInput
        Where no pose gave a sample.
    """
    parts = [pose.samples for pose in poses]
    counts = [part.f_r.shape[0] for part in parts]
    if not sum(counts):
        raise BadInput(
            "no bin has a value in any pose",
            where=source or "session",
            todo="look at the frames: is the sample lit, in view, and the white brighter than the dark?",
        )

    def joined(name: str) -> NDArray[np.generic]:
        return np.concatenate([getattr(part, name) for part in parts])

    bins = 1 + max(int(part.bin_index.max(initial=0)) for part in parts)
    white = np.repeat([pose.white_number for pose in poses], counts)
    samples = make_samples(
        joined("wi"),
        joined("wo"),
        joined("f_r"),
        channels=channels,
        source_solid_angle_sr=source_solid_angle_sr(rig),
        receiver_solid_angle_sr=receiver_solid_angle_sr(rig),
        source=source,
        flags=joined("dropped") | np.repeat([pose.spoiled * SPOILED_POSE for pose in poses], counts)[:, None],
        u_noise=joined("u_noise"),
        u_white=joined("u_white"),
        u_reference=joined("u_reference"),
        u_binning=joined("u_binning"),
        u_lamp=joined("u_lamp"),
        u_linearity=None if u_linearity is None else np.abs(joined("f_r")) * u_linearity,
        u_drift=None if u_drift is None else np.abs(joined("f_r")) * u_drift,
        u_stray=None if any(part.u_stray is None for part in parts) else joined("u_stray"),
        u_distortion=None if any(part.u_distortion is None for part in parts) else joined("u_distortion"),
        u_flat=joined("u_flat"),
        flat_group=joined("bin_index"),
        white_group=white * bins + joined("bin_index"),
        pose=np.repeat([pose.number for pose in poses], counts),
        d_wi=joined("d_wi"),
        d_wo=joined("d_wo"),
        u_joint_rad=joint_resolution(rig),
        joint_group=np.repeat(np.array([pose.ticks for pose in poses]), counts, axis=0),
    )
    # NetCDF knows no tuples.
    samples.attrs |= {
        f"option_{name}": ",".join(value) if isinstance(value, tuple) else value
        for name, value in asdict(options).items()
    }
    samples.attrs |= _totals("pixels", [part.pixel_flags for part in parts])
    samples.attrs |= _totals("dropped", [part.bins_dropped for part in parts])
    samples.attrs |= dict(provenance or {})
    return samples


def _totals(prefix: str, counts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    names = counts[0] if counts else {}
    return {f"{prefix}_{name}": sum(count[name] for count in counts) for name in names}
