"""Samples as a client receives them: frame by frame, as bytes or through shared memory."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterable, Iterator

from oaisys_core.errors import OaisysError
from oaisys_core.types import (
    POINTS,
    Frame,
    FrameName,
    LidarScan,
    Sample,
    SampleOutline,
)
from oaisys_grpc.contract import arrays
from oaisys_grpc.contract.arrays import ArrayAssembly
from oaisys_grpc.contract.sample_messages import (
    FrameMessage,
    complete_sample,
    frame_from_message,
    outline_from_proto,
    scan_from_message,
)
from oaisys_grpc.contract.shared_memory import (
    Reader,
    Segment,
    SharedMemoryError,
)
from oaisys_grpc.contract.transfer import location_from_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

_LOG = logging.getLogger(__name__)

MAX_ARRAY_BYTES = 1 << 30
"""Size of a frame or of a mesh's array, decoded, unless the caller sets a limit."""


class SampleStream:
    """Iterates over frames and scans of a sample as they come: depth and labels before any colour.

    If a stream raises, its frames belong to no sample and must be dropped: another sample will get
    its ids. `sample` is available once the iteration has ended by itself.

    Attributes:
        largest_copied_bytes: Size of the largest frame that came through the connection.
    """

    def __init__(
        self,
        parts: Iterable[pb.SamplePart],
        *,
        limit: int = MAX_ARRAY_BYTES,
        reader: Reader | None = None,
        fetch: Callable[[int, int], Sample] | None = None,
        cancel: Callable[[], object] = lambda: None,
    ) -> None:
        """Read nothing yet.

        Args:
            limit: Most bytes that a frame may have; a larger one is refused before it is received.
            reader: Reads frames in the server's memory; None: they are fetched.
            fetch: Returns the sample of a batch and sample id without shared memory, for frames
                that could not be read there.
            cancel: Cancels the call.
        """
        self._parts = iter(parts)
        self._cancel = cancel
        self._limit = limit
        self._reader = reader
        self._fetch = fetch
        self._frames: dict[FrameName, Frame] = {}
        self._scans: dict[str, LidarScan] = {}
        self._unread: list[FrameName] = []
        self._files: dict[bytes, Segment] = {}
        self._begun: tuple[pb.FrameHeader, ArrayAssembly] | None = None
        self._header: pb.SampleHeader | None = None
        self._sample: Sample | None = None
        self.largest_copied_bytes = 0

    @functools.cached_property
    def outline(self) -> SampleOutline:
        """What the sample will be; available from its first frame on.

        Raises:
            OaisysError: Nothing of the sample has come yet.
        """
        if self._header is None:
            raise OaisysError("the sample has not begun yet")
        return outline_from_proto(self._header)

    @property
    def sample(self) -> Sample:
        """The whole sample.

        Raises:
            OaisysError: Not all of it has come.
        """
        if self._sample is None:
            raise OaisysError("the sample is incomplete: its end has not come")
        return self._sample

    def __iter__(self) -> Iterator[Frame | LidarScan]:
        """Yield each frame and each scan as soon as all of it has come.

        Raises:
            OaisysError: The render failed, or parts are missing or contradict each other.
        """
        for part in self._parts:
            yield from self._take(part)
            if self._sample is not None:
                return  # only the call's status follows

    def cancel(self) -> None:
        """Stop the render; a thread that iterates gets a `CancelledError`."""
        self._cancel()

    def read(self) -> Sample:
        """Read to the end and return the sample."""
        for _ in self:
            pass
        return self.sample

    def _take(self, part: pb.SamplePart) -> Iterator[Frame | LidarScan]:
        """Take the next part; yield the frames that are complete by it."""
        kind = part.WhichOneof("part")
        if kind == "sample":
            self._header = part.sample
        elif kind == "frame":
            yield from self._complete()
            yield from self._begin(part.frame)
        elif kind == "chunk":
            yield from self._add(part.chunk)
        elif kind == "group":
            for member in part.group.parts:
                yield from self._take(member)
        elif kind == "end":
            yield from self._complete()
            yield from self._fetch_frame()
            self._finish(part.end)

    def _begin(self, header: pb.FrameHeader) -> Iterator[Frame | LidarScan]:
        content = header.WhichOneof("content")
        if content == "shared_memory":
            yield from self._map_shared(header)
            return
        assembly = ArrayAssembly(header.array, self._limit)
        self._begun = header, assembly
        self.largest_copied_bytes = max(self.largest_copied_bytes, assembly.nbytes)
        if content == "data":
            yield from self._add(pb.Chunk(index=header.index, data=header.data))

    def _add(self, chunk: pb.Chunk) -> Iterator[Frame | LidarScan]:
        if self._begun is None or chunk.index != self._begun[0].index:
            raise OaisysError("a chunk came without its frame")
        self._begun[1].add(chunk)
        if self._begun[1].is_complete:
            yield from self._complete()

    def _complete(self) -> Iterator[Frame | LidarScan]:
        """Yield the frame that has begun, if there is one."""
        if self._begun is None:
            return
        header, assembly = self._begun
        self._begun = None
        yield from self._keep(FrameMessage(header, assembly.array()))

    def _map_shared(self, header: pb.FrameHeader) -> Iterator[Frame | LidarScan]:
        """Yield a frame that lies in the server's memory, or note that it must be fetched."""
        size = arrays.check_nbytes(header.array, self._limit)
        try:
            if self._reader is None:
                raise SharedMemoryError("this client reads no shared memory")
            data = self._reader.read(location_from_proto(header.shared_memory), size, self._files)
        except SharedMemoryError as error:
            _LOG.info("%s; the frame is fetched instead", error)
            self._unread.append(FrameName(header.sensor, header.modality))
            return
        yield from self._keep(FrameMessage(header, arrays.decode(header.array, data)))

    def _fetch_frame(self) -> Iterator[Frame | LidarScan]:
        if not self._unread or self._fetch is None:
            return
        sample = self._fetch(self.outline.batch_id, self.outline.sample_id)
        for name in self._unread:
            if name.modality == POINTS:
                self._scans[name.sensor] = sample.scan(name.sensor)
                yield self._scans[name.sensor]
                continue
            self._frames[name] = sample.frame(name.sensor, name.modality)
            yield self._frames[name]

    def _keep(self, message: FrameMessage) -> Iterator[Frame | LidarScan]:
        """Keep and yield a frame or a scan."""
        if message.header.modality == POINTS:
            scan = self._scans[message.header.sensor] = scan_from_message(message)
            yield scan
            return
        frame = frame_from_message(message)
        self._frames[FrameName(frame.sensor, frame.modality)] = frame
        yield frame

    def _finish(self, end: pb.SampleEnd) -> None:
        outline = self.outline
        received = {*self._frames, *(FrameName(sensor, POINTS) for sensor in self._scans)}
        if not received >= set(outline.frames):
            raise OaisysError("the sample is incomplete: frames are missing")
        self._sample = complete_sample(outline, self._frames, self._scans, end)
