"""Samples as the contract's messages, with the images beside them; in pairs.

The worker makes these messages, the server relays them, the client reads them.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.types import (
    PLUMB_BOB,
    POINTS,
    FloatArray,
    Frame,
    FrameName,
    LidarScan,
    Odometry,
    PinholeIntrinsics,
    Provenance,
    Sample,
    SampleOutline,
    early_first,
)
from oaisys_grpc.contract import arrays
from oaisys_grpc.contract.arrays import AnyArray
from oaisys_grpc.contract.conversion import Conversion, RecordConversion, each
from oaisys_grpc.contract.metadata import POSE
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


class FrameMessage(NamedTuple):
    """The header of a frame or a scan, and its image or points.

    Attributes:
        header: Describes the image as raw bytes; it must not be changed.
        image: (H, W) or (H, W, channels); of a scan, the (N, S) bytes of its points.
    """

    header: pb.FrameHeader
    image: AnyArray


@dataclass
class SampleMessages:
    """A sample, or the pieces of it that have come so far.

    Attributes:
        header: None if it came with an earlier piece.
        frames: Depth and labels before colour.
        end: None if it comes with a later piece.
    """

    header: pb.SampleHeader | None = None
    frames: list[FrameMessage] = field(default_factory=list)
    end: pb.SampleEnd | None = None

    def add(self, piece: SampleMessages) -> None:
        """Add the next piece."""
        self.header = self.header or piece.header
        self.frames.extend(piece.frames)
        self.end = self.end or piece.end

    def complete(self) -> SampleMessages:
        """Return the complete sample: header and frames say what is known at the end."""
        assert self.header is not None
        assert self.end is not None
        header = pb.SampleHeader()
        header.CopyFrom(self.header)
        header.render_time_s = self.end.render_time_s
        header.provenance.MergeFrom(self.end.provenance)
        frames = [_with_provenance(frame, self.end.provenance) for frame in self.frames]
        return SampleMessages(header, frames, self.end)

    @property
    def batch_id(self) -> int:
        """Id of the batch; 0 until the sample's header has come."""
        return 0 if self.header is None else self.header.batch_id

    @property
    def sample_id(self) -> int:
        """Id of the sample; 0 until its header has come."""
        return 0 if self.header is None else self.header.sample_id

    @property
    def nbytes(self) -> int:
        """Size of all images."""
        return sum(frame.image.nbytes for frame in self.frames)


def _with_provenance(frame: FrameMessage, provenance: pb.Provenance) -> FrameMessage:
    header = pb.FrameHeader()
    header.CopyFrom(frame.header)
    header.provenance.CopyFrom(provenance)
    return FrameMessage(header, frame.image)


def matrix_from_proto(values: Sequence[float]) -> FloatArray:
    """Return the (4, 4) float64 transform of 16 row-major values; inverse: `matrix_to_proto`."""
    return np.array(values[:], dtype=np.float64).reshape(4, 4)


def matrix_to_proto(T: FloatArray) -> list[float]:
    """Return a matrix's values, row by row."""
    values: list[float] = np.asarray(T, dtype=np.float64).ravel().tolist()
    return values


MATRIX = Conversion(matrix_to_proto, matrix_from_proto)

INTRINSICS = RecordConversion(
    PinholeIntrinsics,
    pb.Intrinsics,
    # A server of an earlier version names no model.
    distortion_model=Conversion(str, lambda model: model or PLUMB_BOB),
)
intrinsics_to_proto, intrinsics_from_proto = INTRINSICS.to_proto, INTRINSICS.from_proto

_PROVENANCE = RecordConversion(Provenance, pb.Provenance)
provenance_to_proto, provenance_from_proto = _PROVENANCE.to_proto, _PROVENANCE.from_proto

ODOMETRY = RecordConversion(Odometry, pb.Odometry, pose=POSE)

_OUTLINE = RecordConversion(
    SampleOutline,
    pb.SampleHeader,
    rig_pose=POSE,
    frames=each(RecordConversion(FrameName, pb.FrameName)),
    provenance=_PROVENANCE,
    odometry=ODOMETRY,
)
outline_from_proto = _OUTLINE.from_proto


def outline_to_proto(outline: SampleOutline, render_time_s: float = 0.0) -> pb.SampleHeader:
    """Return the header of a sample; inverse: `outline_from_proto`."""
    count = len(outline.frames)
    return _OUTLINE.to_proto(outline, render_time_s=render_time_s, frame_count=count)


def frame_to_message(frame: Frame, outline: SampleOutline) -> FrameMessage:
    """Return the message of a frame; inverse: `frame_from_message`."""
    header = pb.FrameHeader(
        sensor=frame.sensor,
        modality=frame.modality,
        t_map_camera=matrix_to_proto(frame.T_map_camera),
        provenance=provenance_to_proto(_brief(outline.provenance)),
        index=outline.frames.index(FrameName(frame.sensor, frame.modality)),
        array=arrays.raw_header(frame.data),
    )
    header.MergeFrom(_camera(frame.intrinsics))
    return FrameMessage(header, frame.data)


def frame_from_message(message: FrameMessage) -> Frame:
    """Return a frame."""
    header = message.header
    return Frame(
        sensor=header.sensor,
        modality=header.modality,
        data=message.image,
        intrinsics=intrinsics_from_proto(header.intrinsics),
        T_map_camera=matrix_from_proto(header.t_map_camera),
    )


def scan_to_message(scan: LidarScan, outline: SampleOutline) -> FrameMessage:
    """Return the message of a scan; inverse: `scan_from_message`."""
    dtype = scan.data.dtype
    size = (len(scan.data), dtype.itemsize)
    points = np.frombuffer(scan.data.tobytes(), np.uint8).reshape(size)
    header = pb.FrameHeader(
        sensor=scan.sensor,
        modality=scan.modality,
        t_map_camera=matrix_to_proto(scan.T_map_lidar),
        provenance=provenance_to_proto(_brief(outline.provenance)),
        index=outline.frames.index(FrameName(scan.sensor, scan.modality)),
        array=arrays.raw_header(points),
        point_fields=[_point_field(dtype, name) for name in dtype.names or ()],
    )
    return FrameMessage(header, points)


def _point_field(dtype: np.dtype[Any], name: str) -> pb.PointField:
    assert dtype.fields is not None
    kind, offset, *_ = dtype.fields[name]
    return pb.PointField(name=name, offset=offset, data_type=arrays.data_type_of(kind))


def scan_from_message(message: FrameMessage) -> LidarScan:
    """Return a scan.

    Raises:
        OaisysError: The layout of its points is impossible.
    """
    header, points = message
    try:
        dtype = np.dtype(
            {
                "names": [field.name for field in header.point_fields],
                "formats": [arrays.dtype_of(field.data_type) for field in header.point_fields],
                "offsets": [field.offset for field in header.point_fields],
                "itemsize": points.shape[1],
            }
        )
        data = points.reshape(-1).view(dtype)
    except (ValueError, TypeError, IndexError) as error:
        raise OaisysError(f"the points of {header.sensor} cannot be read: {error}") from error
    return LidarScan(header.sensor, data, matrix_from_proto(header.t_map_camera))


def end_to_proto(sample: Sample) -> pb.SampleEnd:
    """Return the message that follows the last frame of a sample."""
    return pb.SampleEnd(
        render_time_s=sample.render_time_s,
        provenance=provenance_to_proto(_brief(sample.provenance)),
        finished_monotonic_ns=sample.finished_ns,
    )


def sample_to_messages(sample: Sample) -> SampleMessages:
    """Return the messages of a complete sample; inverse: `sample_from_messages`."""
    outline = sample.outline
    return SampleMessages(
        outline_to_proto(outline, sample.render_time_s),
        [
            *(scan_to_message(scan, outline) for scan in sample.scans),
            *(frame_to_message(frame, outline) for frame in early_first(sample.frames)),
        ],
        end_to_proto(sample),
    )


def sample_from_messages(messages: SampleMessages) -> Sample:
    """Return a complete sample."""
    assert messages.header is not None
    assert messages.end is not None
    is_scan = [message.header.modality == POINTS for message in messages.frames]
    pairs = list(zip(messages.frames, is_scan, strict=True))
    frames = [frame_from_message(message) for message, of_lidar in pairs if not of_lidar]
    scans = [scan_from_message(message) for message, of_lidar in pairs if of_lidar]
    return complete_sample(
        outline_from_proto(messages.header),
        {FrameName(frame.sensor, frame.modality): frame for frame in frames},
        {scan.sensor: scan for scan in scans},
        messages.end,
    )


def complete_sample(
    outline: SampleOutline,
    frames: Mapping[FrameName, Frame],
    scans: Mapping[str, LidarScan],
    end: pb.SampleEnd,
) -> Sample:
    """Return the sample whose frames, and scans by the lidar's name, have all come."""
    begun = outline.provenance
    return Sample(
        batch_id=outline.batch_id,
        sample_id=outline.sample_id,
        rig_pose=outline.rig_pose,
        frames=tuple(frames[name] for name in outline.frames if name.modality != POINTS),
        scans=tuple(scans[name.sensor] for name in outline.frames if name.modality == POINTS),
        render_time_s=end.render_time_s,
        provenance=replace(
            provenance_from_proto(end.provenance),
            metadata_json=begun.metadata_json,
            previous_poses_json=begun.previous_poses_json,
            motion_json=begun.motion_json,
        ),
        from_cache=outline.from_cache,
        finished_ns=end.finished_monotonic_ns,
        odometry=outline.odometry,
    )


def messages_to_bytes(messages: SampleMessages) -> tuple[bytes, list[AnyArray]]:
    """Return the headers as one message, and the images; inverse: `messages_from_bytes`."""
    parts = [pb.SamplePart(sample=messages.header)] if messages.header is not None else []
    parts += [pb.SamplePart(frame=frame.header) for frame in messages.frames]
    parts += [pb.SamplePart(end=messages.end)] if messages.end is not None else []
    content = pb.SamplePartGroup(parts=parts).SerializeToString()
    return content, [frame.image for frame in messages.frames]


def messages_from_bytes(content: bytes, images: Sequence[NDArray[np.uint8]]) -> SampleMessages:
    """Return the messages whose images are these raw bytes."""
    messages = SampleMessages()
    for part in pb.SamplePartGroup.FromString(content).parts:
        if part.HasField("sample"):
            messages.header = part.sample
        elif part.HasField("frame"):
            image = arrays.decode(part.frame.array, images[len(messages.frames)])
            messages.frames.append(FrameMessage(part.frame, image))
        else:
            messages.end = part.end
    return messages


@functools.lru_cache(maxsize=8)
def _brief(provenance: Provenance) -> Provenance:
    """Return it without the long texts, which only the sample's header has."""
    return replace(provenance, metadata_json="", previous_poses_json="", motion_json="")


@functools.lru_cache(maxsize=64)
def _camera(intrinsics: PinholeIntrinsics) -> pb.FrameHeader:
    """Return what the headers of all frames of a camera share; it must not be changed."""
    return pb.FrameHeader(
        intrinsics=intrinsics_to_proto(intrinsics), k=matrix_to_proto(intrinsics.K)
    )
