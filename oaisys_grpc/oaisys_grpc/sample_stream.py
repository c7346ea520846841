"""A sample as a client gets it: frame by frame, as they are rendered."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from oaisys_core.errors import OaisysError
from oaisys_core.types import Frame, FrameName, Sample, SampleOutline
from oaisys_grpc import conversions
from oaisys_grpc.chunks import ArrayAssembly, frame_from_header
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


class SampleStream:
    """Iterates over the frames of a sample as they come: depth and labels before any colour.

    Frames of a stream that raises belong to no sample and must be thrown away: its ids will be
    those of another one. `sample` is there once the iteration has ended by itself.
    """

    def __init__(self, parts: Iterable[pb.SamplePart]) -> None:
        self._parts = iter(parts)
        self._frames: dict[FrameName, Frame] = {}
        self._begun: tuple[pb.FrameHeader, ArrayAssembly] | None = None
        self._header: pb.SampleHeader | None = None
        self._sample: Sample | None = None

    @property
    def outline(self) -> SampleOutline:
        """What the sample will be; there from its first frame on.

        Raises:
            OaisysError: It has not come yet.
        """
        header = self._header
        if header is None:
            raise OaisysError("the sample has not begun yet")
        return SampleOutline(
            batch_id=header.batch_id,
            sample_id=header.sample_id,
            rig_pose=conversions.pose_from_proto(header.rig_pose),
            frames=tuple(FrameName(name.sensor, name.modality) for name in header.frames),
            provenance=conversions.provenance_from_proto(header.provenance),
            from_cache=header.from_cache,
        )

    @property
    def sample(self) -> Sample:
        """The whole sample.

        Raises:
            OaisysError: Not all of it has come.
        """
        if self._sample is None:
            raise OaisysError("the sample is incomplete: its end has not come")
        return self._sample

    def __iter__(self) -> Iterator[Frame]:
        """Yield each frame as soon as all of it has come.

        Raises:
            OaisysError: The render failed, or parts are missing or contradict each other.
        """
        for part in self._parts:
            kind = part.WhichOneof("part")
            if kind == "sample":
                self._header = part.sample
            elif kind == "frame":
                yield from self._taken()
                self._begun = part.frame, ArrayAssembly(part.frame.array)
            elif kind == "chunk":
                self._take(part.chunk)
                if self._begun is not None and self._begun[1].is_complete:
                    yield from self._taken()
            elif kind == "end":
                yield from self._taken()
                self._finish(part.end)

    def read(self) -> Sample:
        """Read to the end and return the sample."""
        for _ in self:
            pass
        return self.sample

    def _take(self, chunk: pb.Chunk) -> None:
        if self._begun is None or chunk.index != self._begun[0].index:
            raise OaisysError("a chunk came without its frame")
        self._begun[1].add(chunk)

    def _taken(self) -> Iterator[Frame]:
        """Yield the frame that has begun, if there is one."""
        if self._begun is None:
            return
        header, assembly = self._begun
        self._begun = None
        frame = frame_from_header(header, assembly.array())
        self._frames[FrameName(frame.sensor, frame.modality)] = frame
        yield frame

    def _finish(self, end: pb.SampleEnd) -> None:
        outline = self.outline
        if outline.frames != tuple(name for name in outline.frames if name in self._frames):
            raise OaisysError("the sample is incomplete: frames are missing")
        self._sample = Sample(
            batch_id=outline.batch_id,
            sample_id=outline.sample_id,
            rig_pose=outline.rig_pose,
            frames=tuple(self._frames[name] for name in outline.frames),
            render_time_s=end.render_time_s,
            provenance=conversions.provenance_from_proto(end.provenance),
            from_cache=outline.from_cache,
        )


def sample_from_parts(parts: Iterable[pb.SamplePart]) -> Sample:
    """Return the sample whose parts these are; inverse: `oaisys_grpc.chunks.sample_to_parts`.

    Raises:
        OaisysError: Parts are missing or contradict each other.
    """
    return SampleStream(parts).read()
