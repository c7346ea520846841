"""The calls that a worker answers: the contract's messages in, the contract's messages out.

Must not import gRPC.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Container, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from weakref import WeakSet

import numpy as np

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import CancelledError, NotReadyError
from oaisys_core.files.path_fields import AssetRoots, confine_paths
from oaisys_core.render.base import FrameGroup
from oaisys_core.render.view_renderer import SampleSteps
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, ModuleMetadata, Progress, Sample, SampleOutline
from oaisys_grpc.contract.arrays import AnyArray
from oaisys_grpc.contract.metadata import metadata_from_proto, names
from oaisys_grpc.contract.sample_messages import (
    SampleMessages,
    end_to_proto,
    frame_to_message,
    messages_to_bytes,
    outline_to_proto,
    scan_to_message,
)
from oaisys_grpc.contract.shared_memory import (
    SHARED_FROM_BYTES,
    Segment,
    segment_of,
    share_if_possible,
)
from oaisys_grpc.contract.world_messages import (
    heights_to_proto,
    mesh_to_message,
    page_to_proto,
    query_from_proto,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.worker import fault_injection
from oaisys_grpc.worker.drive_calls import DriveCalls
from oaisys_grpc.worker.height_cells import SurfaceNames, height_cells
from oaisys_grpc.worker.protocol import Connection, WorkerMessage

MAX_SEGMENTS = 400
"""In which frames, such as those of the cache, may lie; each takes two descriptors."""

_PROGRESS_PERIOD_S = 0.05


class Reply(NamedTuple):
    """What a call returns: a serialized message of the contract, and its arrays."""

    content: bytes = b""
    arrays: Sequence[AnyArray] = ()


class CallContext:
    """Sends what a call has to say while it runs, and stops it where it was cancelled."""

    def __init__(self, connection: Connection, call: int, cancelled: Container[int]) -> None:
        """Begin a call.

        Args:
            call: Its number.
            cancelled: The numbers of cancelled calls; another thread adds to them.
        """
        self._connection = connection
        self._call = call
        self._cancelled = cancelled
        self._last_stage = ""
        self._last_s = 0.0

    def progress(self, progress: Progress) -> None:
        """Send the progress, not too often; raise `CancelledError` as `stop_if_cancelled`."""
        self.stop_if_cancelled()
        now_s = time.monotonic()
        if progress.stage == self._last_stage and now_s - self._last_s < _PROGRESS_PERIOD_S:
            return
        self._last_stage, self._last_s = progress.stage, now_s
        self._connection.send({"type": "progress", "id": self._call, **vars(progress)})

    def send_frames(self, frames: Reply) -> None:
        """Send frames, or whatever else of a sample is ready, unless the call was cancelled."""
        self.stop_if_cancelled()
        self._connection.send({"type": "frames", "id": self._call}, *frames)

    def stop_if_cancelled(self) -> None:
        """Raise `CancelledError` where the call was cancelled, or its time is over."""
        if self._call in self._cancelled:
            raise CancelledError("cancelled by the caller")


class SimulationCalls:
    """Answers calls with one `Simulation`."""

    def __init__(self) -> None:
        self.simulation: Simulation | None = None
        self.roots: AssetRoots | None = None
        self._drives: DriveCalls | None = None
        self._surfaces = SurfaceNames()
        self._segments: WeakSet[Segment] = WeakSet()
        self._methods: dict[str, Callable[[WorkerMessage, CallContext], Reply]] = {
            "start": self._start,
            "step_batch": self._step_batch,
            "step_sample": self._step_sample,
            "plan_trajectory": self._plan_trajectory,
            "drive_header": self._drive_header,
            "drive_instants": self._drive_instants,
            "drive_sample": self._drive_sample,
            "withdraw_sample": self._withdraw_sample,
            "ground_truth_mesh": self._ground_truth_mesh,
            "list_objects": self._list_objects,
            "height_cells": self._height_cells,
            "query_height": self._query_height,
        }

    def answer(self, call: WorkerMessage, context: CallContext) -> Reply:
        """Do what a call asks for.

        Raises:
            OaisysError: The request is refused, or it fails.
        """
        if os.environ.get("OAISYS_FAULT"):
            fault_injection.inject_asked(call.content)
        return self._methods[call.head["method"]](call, context)

    def _start(self, call: WorkerMessage, context: CallContext) -> Reply:
        """Set the simulation up, in the state that an earlier worker left."""
        config = config_from_mapping(call.head["config"])
        simulation = Simulation(
            config, pose_cache_bytes=call.head["pose_cache_bytes"], place_frames=self._place
        )
        self.roots = AssetRoots.of(map(Path, call.head["asset_roots"]), config)
        if call.head["state"] is not None:
            with confine_paths(self.roots):
                simulation.restore(json.loads(call.head["state"]), context.progress)
        self.simulation, self._drives = simulation, DriveCalls(simulation, config)
        return Reply()

    def _step_batch(self, call: WorkerMessage, context: CallContext) -> Reply:
        simulation = self._ready()
        request = pb.StepBatchRequest.FromString(call.content)
        _inject_faults("batch", context)
        self._surfaces.forget()
        simulation.step_batch(
            _metadata(request),
            seed=request.seed if request.HasField("seed") else None,
            reuse_stage=request.reuse_stage,
            progress=context.progress,
        )
        return Reply()

    def _step_sample(self, call: WorkerMessage, context: CallContext) -> Reply:
        simulation = self._ready()
        request = pb.StepSampleRequest.FromString(call.content)
        _inject_faults("sample", context)
        steps = simulation.stream_sample(
            _metadata(request),
            modalities=names(request.modalities, "modalities"),
            sensors=names(request.sensors, "sensors"),
            progress=context.progress,
        )
        return _send_frames(steps, context)

    def _plan_trajectory(self, call: WorkerMessage, _context: CallContext) -> Reply:
        request = pb.SetTrajectoryRequest.FromString(call.content)
        return Reply(self._ready_drives().plan(request).SerializeToString())

    def _drive_header(self, call: WorkerMessage, _context: CallContext) -> Reply:
        step = pb.DriveStep.FromString(call.content)
        return Reply(self._ready_drives().header(step).SerializeToString())

    def _drive_instants(self, call: WorkerMessage, _context: CallContext) -> Reply:
        step = pb.DriveStep.FromString(call.content)
        return Reply(self._ready_drives().instants(step).SerializeToString())

    def _drive_sample(self, call: WorkerMessage, context: CallContext) -> Reply:
        """Do as `_step_sample` at a time of a drive."""
        view = self._ready_drives().view(pb.DriveStep.FromString(call.content))
        _inject_faults("sample", context)
        steps = self._ready().stream_sample(
            view.metadata,
            sensors=view.sensors,
            motion=view.motion,
            progress=context.progress,
        )
        return _send_frames(steps, context)

    def _withdraw_sample(self, _call: WorkerMessage, _context: CallContext) -> Reply:
        self._ready().withdraw_sample()
        return Reply()

    def _ground_truth_mesh(self, _call: WorkerMessage, _context: CallContext) -> Reply:
        message, arrays = mesh_to_message(self._ready().ground_truth_mesh())
        return Reply(message.SerializeToString(), arrays)

    def _list_objects(self, call: WorkerMessage, _context: CallContext) -> Reply:
        request = pb.ListObjectsRequest.FromString(call.content)
        page = self._ready().list_objects(query_from_proto(request), _metadata(request))
        return Reply(page_to_proto(page).SerializeToString())

    def _height_cells(self, call: WorkerMessage, _context: CallContext) -> Reply:
        request = pb.HeightCellsRequest.FromString(call.content)
        message, heights_m = height_cells(request, self._ready(), self._surfaces)
        return Reply(message.SerializeToString(), heights_m)

    def _query_height(self, call: WorkerMessage, _context: CallContext) -> Reply:
        request = pb.QueryHeightRequest.FromString(call.content)
        points_m = np.array(request.points_m, dtype=np.float64).reshape(-1, 3)
        heights = self._ready().query_height(points_m)
        return Reply(heights_to_proto(heights).SerializeToString())

    def _ready(self) -> Simulation:
        if self.simulation is None:
            raise NotReadyError("the worker was not started")
        return self.simulation

    def _ready_drives(self) -> DriveCalls:
        if self._drives is None:
            raise NotReadyError("the worker was not started")
        return self._drives

    def _place(self, frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
        """Return frames as they lie in one segment of shared memory; small ones stay as they are.

        The cache then keeps what is sent, and what it keeps is sent again without being copied.
        """
        size = sum(frame.data.nbytes for frame in frames)
        if size < SHARED_FROM_BYTES or len(self._segments) >= MAX_SEGMENTS:
            return frames
        images = share_if_possible([frame.data for frame in frames])
        if images is None:
            return frames
        segment = segment_of(images[0])
        assert segment is not None
        self._segments.add(segment)
        return tuple(replace(f, data=image) for f, image in zip(frames, images, strict=True))


def _send_frames(steps: SampleSteps, context: CallContext) -> Reply:
    """Send the frames of a sample as they become ready; return the end of the sample."""
    with ThreadPoolExecutor(1, "sender") as executor:
        sender = _FrameSender(context, executor)
        try:
            while True:
                sender.send(*next(steps))
        except StopIteration as end:
            sample: Sample = end.value
        finally:
            steps.close()
        sender.wait()
    _inject_faults("end", context)
    return sender.rest(sample)


class _FrameSender:
    """Sends groups of frames in order, each once.

    A group that another thread still computes is waited for and sent by a thread, so that colour is
    rendered meanwhile.
    """

    def __init__(self, context: CallContext, executor: Executor) -> None:
        self._context = context
        self._executor = executor
        self._sending: Future[None] | None = None
        self._has_header = False

    def send(self, outline: SampleOutline, group: FrameGroup) -> None:
        """Send a group after those before it.

        Raises:
            Exception: Whatever computing or sending a group before, or this one, raised.
        """
        self.wait()
        if group.is_done():
            self._send(outline, group)
        else:
            run = copy_context().run
            self._sending = self._executor.submit(run, self._send, outline, group)

    def wait(self) -> None:
        """Wait until all groups so far are sent; see `send`."""
        if self._sending is not None:
            self._sending.result()

    def rest(self, sample: Sample) -> Reply:
        """Return what ends the sample."""
        header = None if self._has_header else outline_to_proto(sample.outline)
        return Reply(*messages_to_bytes(SampleMessages(header, end=end_to_proto(sample))))

    def _send(self, outline: SampleOutline, group: FrameGroup) -> None:
        is_first = not self._has_header
        frames = [scan_to_message(scan, outline) for scan in group.scans]
        frames += [frame_to_message(frame, outline) for frame in group.result()]
        header = outline_to_proto(outline) if is_first else None
        self._has_header = True
        self._context.send_frames(Reply(*messages_to_bytes(SampleMessages(header, frames))))
        if is_first:
            _inject_faults("frames", self._context)


def _metadata(
    request: pb.StepBatchRequest | pb.StepSampleRequest | pb.ListObjectsRequest,
) -> ModuleMetadata | None:
    if not request.HasField("metadata"):
        return None
    return metadata_from_proto(request.metadata)


def _inject_faults(moment: fault_injection.Moment, context: CallContext) -> None:
    if os.environ.get("OAISYS_FAULT"):
        fault_injection.inject(moment, context.progress)
