"""Requests samples from a server: through shared memory if that works, otherwise as bytes."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from oaisys_core.errors import OaisysError
from oaisys_core.types import (
    Progress,
    Sample,
)
from oaisys_grpc.addresses import is_this_machine
from oaisys_grpc.client.channel import Channel, translate_errors
from oaisys_grpc.client.sample_stream import SampleStream
from oaisys_grpc.contract.operation import progress_from_proto
from oaisys_grpc.contract.shared_memory import (
    SHARED_FROM_BYTES,
    Reader,
    SharedMemoryError,
    find_token,
)
from oaisys_grpc.contract.transfer import Transfer, location_from_proto, transfer_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

_LOG = logging.getLogger(__name__)

ProgressListener = Callable[[Progress], None]

_INLINE_BYTES = 64 << 10
"""Larger frames come in chunks."""

_MESSAGE_BYTES = 1 << 20
"""Array data of one message; larger ones do not fit into the processor's cache."""

_ASK_AGAIN_S = 10.0

_ASK_TIMEOUT_S = 2.0


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
