"""Samples as a client receives them: frame by frame, as bytes or through shared memory."""

from __future__ import annotations

import contextlib
import functools
import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from oaisys_core.errors import OaisysError
from oaisys_core.types import (
    POINTS,
    Frame,
    FrameName,
    LidarScan,
    Progress,
    Sample,
    SampleOutline,
)
from oaisys_grpc.addresses import is_this_machine
from oaisys_grpc.client.channel import Channel, translate_errors
from oaisys_grpc.contract import arrays
from oaisys_grpc.contract.arrays import ArrayAssembly
from oaisys_grpc.contract.operation import progress_from_proto
from oaisys_grpc.contract.sample_messages import (
    FrameMessage,
    complete_sample,
    frame_from_message,
    outline_from_proto,
    scan_from_message,
)
from oaisys_grpc.contract.shared_memory import (
    SHARED_FROM_BYTES,
    Reader,
    Segment,
    SharedMemoryError,
    find_token,
)
from oaisys_grpc.contract.transfer import Transfer, location_from_proto, transfer_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

_LOG = logging.getLogger(__name__)

ProgressListener = Callable[[Progress], None]

MAX_ARRAY_BYTES = 1 << 30
"""Size of a frame or of a mesh's array, decoded, unless the caller sets a limit."""

_INLINE_BYTES = 64 << 10
"""Larger frames come in chunks."""

_MESSAGE_BYTES = 1 << 20
"""Array data of one message; larger ones do not fit into the processor's cache."""

_ASK_AGAIN_S = 10.0
_ASK_TIMEOUT_S = 2.0


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


class SampleClient:
    """Receives samples through shared memory if that works, otherwise as bytes."""

    def __init__(
        self,
        channel: Channel,
        encodings: tuple[int, ...],
        max_frame_bytes: int,
        *,
        shared_memory: bool,
    ) -> None:
        self._channel = channel
        self._reader = Reader()
        self._wanted = Transfer(
            encodings=encodings,
            inline_bytes=_INLINE_BYTES,
            chunk_bytes=_MESSAGE_BYTES,
            frame_bytes=max_frame_bytes,
            grouped=True,
            group_bytes=_MESSAGE_BYTES,
        )
        self._token = b""
        self._ask_from_s = 0.0 if shared_memory and is_this_machine(channel.address) else None
        self._lock = threading.Lock()

    def transfer(self, timeout_s: float) -> Transfer:
        """Return how frames should come; asks the server once whether it shares memory."""
        return replace(self._wanted, token=self._find_token(timeout_s))

    @contextlib.contextmanager
    def render(
        self,
        request: pb.RenderSampleRequest,
        timeout_s: float,
        on_progress: ProgressListener | None,
    ) -> Iterator[SampleStream]:
        """Request a sample; leaving the block early cancels it."""
        with self._channel.stream("RenderSample", request, timeout_s) as call:
            parts = _parts_after_progress(call, on_progress)
            stream = self._stream(parts, timeout_s, call.cancel)
            yield stream
            self._learn(request.transfer, stream)

    def byte_transfer(self) -> Transfer:
        """Return how frames should come that stay when the server drops them: as bytes."""
        return self._wanted

    def fetch_sample(
        self, batch_id: int, sample_id: int, timeout_s: float, transfer: Transfer | None = None
    ) -> Sample:
        """Return a recent sample."""
        options = transfer_to_proto(transfer or self.transfer(timeout_s))
        request = pb.GetSampleRequest(batch_id=batch_id, sample_id=sample_id, transfer=options)
        with self._channel.stream("GetSample", request, timeout_s) as answers:
            parts = (answer.part for answer in answers)
            stream = self._stream(parts, timeout_s)
            sample = stream.read()
        self._learn(options, stream)
        return sample

    def _stream(
        self,
        parts: Iterable[pb.SamplePart],
        timeout_s: float,
        cancel: Callable[[], object] = lambda: None,
    ) -> SampleStream:
        def fetch(batch_id: int, sample_id: int) -> Sample:
            return self.fetch_sample(batch_id, sample_id, timeout_s, self._wanted)

        limit = self._wanted.frame_bytes
        return SampleStream(parts, limit=limit, reader=self._reader, fetch=fetch, cancel=cancel)

    def _find_token(self, timeout_s: float) -> bytes:
        with self._lock:
            now_s = time.monotonic()
            if self._token or self._ask_from_s is None or now_s < self._ask_from_s:
                return self._token
            self._ask_from_s = now_s + _ASK_AGAIN_S
            request = pb.GetSimulatorInfoRequest()
            try:
                patience_s = min(timeout_s, _ASK_TIMEOUT_S)
                info = self._channel.call("GetSimulatorInfo", request, patience_s)
                if info.HasField("shared_memory_probe"):
                    self._token = find_token(location_from_proto(info.shared_memory_probe))
            except (OaisysError, SharedMemoryError) as error:
                _LOG.info("no shared memory with %s: %s", self._channel.address, error)
            return self._token

    def _learn(self, options: pb.TransferOptions, stream: SampleStream) -> None:
        """Forget the token if large frames came as bytes despite it: the server was replaced."""
        if options.shared_memory_token and stream.largest_copied_bytes >= SHARED_FROM_BYTES:
            with self._lock:
                if self._token == options.shared_memory_token:
                    self._token, self._ask_from_s = b"", 0.0


def _parts_after_progress(
    events: Iterable[pb.RenderSampleResponse], on_progress: ProgressListener | None
) -> Iterator[pb.SamplePart]:
    """Yield the sample's parts; tell the listener of progress."""
    with translate_errors():
        for event in events:
            if event.HasField("part"):
                yield event.part
            elif on_progress is not None:
                on_progress(progress_from_proto(event.operation.progress))
