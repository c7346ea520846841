"""The process that runs the simulation: ``python -m oaisys_grpc.worker``, started by the server.

Blender belongs on a process's main thread and may crash, hang or grow; so it works here, behind a
socket pair, and never outlives its server. Must not import gRPC.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import faulthandler
import gc
import json
import logging
import os
import queue
import signal
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from oaisys_core.backend.base import FrameGroup
from oaisys_core.config import config_from_mapping
from oaisys_core.config.paths import AssetRoots, confined
from oaisys_core.errors import CancelledError, NotReadyError, OaisysError, RenderError
from oaisys_core.interruption import interruptible
from oaisys_core.sensing.view_renderer import SampleSteps
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, Progress, Sample, SampleOutline, SimulatorInfo
from oaisys_grpc.contract.faults import fault_from_error
from oaisys_grpc.worker import fault_injection
from oaisys_grpc.worker.frame_placement import FramePlacement
from oaisys_grpc.worker.limits import limit_worker
from oaisys_grpc.worker.protocol import Connection, Message

_LOG = logging.getLogger(__name__)
_PR_SET_PDEATHSIG = 1
_PROGRESS_PERIOD_S = 0.05
_REST_S = 0.01


class Worker:
    """Answers one call after the other on the main thread; a second thread listens for cancels."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._calls: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._cancelled: set[int] = set()
        self._simulation: Simulation | None = None
        self._told: SimulatorInfo | None = None
        self._roots: AssetRoots | None = None
        self._placement = FramePlacement()
        self._methods: dict[str, Callable[[Message, _Reporter], Any]] = {
            "start": self._start,
            "step_batch": self._step_batch,
            "step_sample": self._step_sample,
            "withdraw_sample": lambda _a, _r: self._ready().withdraw_sample(),
            "ground_truth_mesh": lambda _a, _r: self._ready().ground_truth_mesh(),
            "list_objects": lambda a, _r: self._ready().list_objects(**a),
            "height_grid": lambda a, report: self._ready().height_grid(**a, progress=report),
            "query_height": lambda a, _r: self._ready().query_height(a["points_m"]),
        }

    def run(self) -> None:
        """Work until told to end."""
        threading.Thread(target=self._listen, name="listener", daemon=True).start()
        while (call := self._next())["type"] != "end":
            self._answer(call)
        if self._simulation is not None:
            self._simulation.close()

    def _next(self) -> Message:
        """Return the next call; find memory for its frames first, once nobody needs the processor.

        Who got the last answer has work with it for a moment.
        """
        call: Message | None = None
        with contextlib.suppress(queue.Empty):
            call = self._calls.get(timeout=_REST_S)
        self._placement.tidy()
        self._placement.prepare()
        return self._calls.get() if call is None else call

    def _listen(self) -> None:
        """Take messages in while the main thread works; end with the server."""
        while True:
            try:
                message = self._connection.receive()
            except EOFError:
                os._exit(0)  # the main thread may be deep inside Blender
            if message["type"] == "cancel":
                self._cancelled.add(message["id"])
            else:
                self._calls.put(message)

    def _answer(self, call: Message) -> None:
        number = call["id"]
        answer: Message = {"id": number}
        try:
            reporter = _Reporter(self._connection, number, self._cancelled, self._placement)
            with confined(self._roots), interruptible(reporter.stop_if_cancelled):
                answer["value"] = self._methods[call["method"]](call["arguments"], reporter)
        except OaisysError as error:
            answer["fault"] = vars(fault_from_error(error))
        except Exception as error:  # noqa: BLE001 - whatever failed is the caller's to know
            _LOG.exception("%s failed", call["method"])
            failure = RenderError(f"{call['method']} failed: {type(error).__name__}: {error}")
            answer["fault"] = vars(fault_from_error(failure))
        self._cancelled.discard(number)
        if self._simulation is not None:
            answer |= self._standing(self._simulation)
        self._connection.send({"type": "answer", **answer})
        gc.enable()

    def _standing(self, simulation: Simulation) -> Message:
        """Return how the world stands: what another worker goes on from, and what is news of it.

        Somebody waits for the sample that it goes with: the server keeps the state as the text
        that it is, and hears of cameras and labels only where they changed.
        """
        info = simulation.info()
        standing: Message = {"batch_id": info.batch_id, "sample_id": info.sample_id}
        standing["state"] = json.dumps(simulation.state())
        lasting = replace(info, batch_id=0, sample_id=0)
        if self._told is None or _differs(lasting, self._told):
            self._told = standing["info"] = lasting
        return standing

    def _start(self, arguments: Message, report: _Reporter) -> None:
        config = config_from_mapping(arguments["config"])
        simulation = Simulation(
            config, pose_cache_bytes=arguments["pose_cache_bytes"], place_frames=self._placement
        )
        self._roots = AssetRoots.of(map(Path, arguments["asset_roots"]), config)
        if arguments["state"] is not None:
            with confined(self._roots):
                simulation.restore(json.loads(arguments["state"]), report)
        self._simulation = simulation

    def _step_batch(self, arguments: Message, report: _Reporter) -> int:
        simulation = self._ready()
        fault_injection.strike_batch(report)
        return simulation.step_batch(**arguments, progress=report)

    def _step_sample(self, arguments: Message, report: _Reporter) -> Sample:
        """Send each frame as soon as it is ready, and return the sample without them."""
        simulation = self._ready()
        fault_injection.strike(report)
        steps = simulation.stream_sample(**arguments, progress=report)
        with ThreadPoolExecutor(1, "sender") as executor:
            sample = _sent(steps, report, executor)
        fault_injection.strike_last(report)
        if len(report.last_frames) == len(sample.frames):
            return sample
        return replace(sample, frames=report.last_frames)

    def _ready(self) -> Simulation:
        if self._simulation is None:
            raise NotReadyError("the worker was not started")
        return self._simulation


class _Reporter:
    """The callbacks of one call: tell the server, and stop where it was cancelled."""

    def __init__(
        self,
        connection: Connection,
        call: int,
        cancelled: set[int],
        placement: FramePlacement,
    ) -> None:
        self._connection = connection
        self._placement = placement
        self._call = call
        self._cancelled = cancelled
        self._told = 0
        self.last_frames: tuple[Frame, ...] = ()
        self._last_stage = ""
        self._last_s = 0.0
        self._has_sent = False

    def __call__(self, progress: Progress) -> None:
        self.stop_if_cancelled()
        now_s = time.monotonic()
        if progress.stage == self._last_stage and now_s - self._last_s < _PROGRESS_PERIOD_S:
            return
        self._last_stage, self._last_s = progress.stage, now_s
        self._connection.send({"type": "progress", "id": self._call, **vars(progress)})

    def frames(self, outline: SampleOutline, frames: tuple[Frame, ...]) -> None:
        """Tell the server frames that are ready; the last ones go with the answer."""
        self.stop_if_cancelled()
        self._told += len(frames)
        if self._told == len(outline.frames):
            self.last_frames = frames
            gc.disable()  # until the answer is out: somebody waits
            return
        message = {"type": "frames", "id": self._call, "outline": outline, "frames": frames}
        self._connection.send(message)
        self._placement.prepare()
        if not self._has_sent:
            self._has_sent = True
            fault_injection.strike_late(self)

    def stop_if_cancelled(self) -> None:
        """Raise where the call was cancelled, or its time is over."""
        if self._call in self._cancelled:
            raise CancelledError("cancelled by the caller")


def _sent(steps: SampleSteps, report: _Reporter, executor: Executor) -> Sample:
    """Send frames as they become ready: those that a thread still computes by another thread."""
    sending: Future[None] | None = None
    while True:
        try:
            outline, group = next(steps)
            if sending is not None:
                sending.result()
            if group.done():
                report.frames(outline, group.result())
            else:
                send = partial(_send, report, outline, group)
                sending = executor.submit(copy_context().run, send)
        except StopIteration as end:
            sample: Sample = end.value
            return sample
        except BaseException:
            steps.close()
            raise


def _send(report: _Reporter, outline: SampleOutline, group: FrameGroup) -> None:
    report.frames(outline, group.result())


def _differs(info: SimulatorInfo, told: SimulatorInfo) -> bool:
    """Return whether they may tell of different things."""
    if info.sensors is not told.sensors:  # they hold arrays
        return True
    return replace(info, sensors=()) != replace(told, sensors=())


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel kill this process when its server ends, however that ends."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent_pid:
        os._exit(0)


def main() -> int:
    """Run a worker on the inherited descriptor."""
    parser = argparse.ArgumentParser(prog="oaisys_grpc.worker.program")
    parser.add_argument("--fd", type=int, required=True)
    parser.add_argument("--parent", type=int, required=True)
    options = parser.parse_args()
    die_with_parent(options.parent)
    limit_worker()
    # What a crash was in goes to the log, and from there into the error.
    faulthandler.enable(all_threads=False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the server's to handle
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    Worker(Connection(socket.socket(fileno=options.fd))).run()
    return 0
