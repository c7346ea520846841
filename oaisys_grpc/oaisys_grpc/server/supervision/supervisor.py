"""Keeps a worker running: replaces one that died and restores its world."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections.abc import Callable, Iterator
from typing import Any

from oaisys_core.config import SimulationConfig, canonical_json
from oaisys_core.errors import (
    BackendUnavailableError,
    CancelledError,
    DeadlineExceededError,
    OaisysError,
    WorkerLostError,
)
from oaisys_core.types import Pose
from oaisys_grpc.contract.faults import Fault, error_from_fault
from oaisys_grpc.contract.metadata import pose_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.server.options import ServerOptions
from oaisys_grpc.server.supervision.crashes import Cause, Crashes
from oaisys_grpc.server.supervision.worker_limits import MEGABYTE, Breaker, CallLimit, MemoryLimits
from oaisys_grpc.server.supervision.worker_log import WorkerLog
from oaisys_grpc.server.supervision.worker_process import WorkerProcess
from oaisys_grpc.worker.protocol import WorkerMessage

_LOG = logging.getLogger(__name__)

START_TIMEOUT_S = 300.0
"""For a worker to load Blender and to restore the world."""

WITHDRAW_TIMEOUT_S = 10.0
"""For a worker to undo a sample."""

_ENDING = "the server was told to end"

START_METHOD = "start"

BATCH_METHOD = "step_batch"

SAMPLE_METHODS = frozenset({"step_sample", "drive_sample"})
"""The only calls for which a worker that ignores a cancellation is killed before the deadline."""

CHANGING_METHODS = SAMPLE_METHODS | {BATCH_METHOD}
"""Calls whose success makes a client known."""


class Supervisor:
    """Owns the worker process, and remembers the state of its world.

    One thread calls `start`, `call`, `withdraw`, `ensure_worker` and `end`; it must live as long as
    the worker. Any thread may call `kill` and read attributes and properties.
    """

    def __init__(
        self,
        config: SimulationConfig,
        options: ServerOptions,
        on_ready: Callable[[bool], None],
    ) -> None:
        """Start nothing yet.

        Args:
            options: The worker's interpreter, time and memory.
            on_ready: Called with True when a worker is ready, with False when none is.
        """
        self._config: dict[str, Any] = config.model_dump(mode="json")
        self.config_json = canonical_json(config)
        self._options = options
        self._memory = MemoryLimits.of(options.worker_memory_bytes)
        self._on_ready = on_ready
        self.log = WorkerLog()
        self._worker: WorkerProcess | None = None
        self._needed_bytes = 0
        self._state: str | None = None
        self._info: pb.GetSimulatorInfoResponse | None = None
        self._breaker = Breaker()
        self._crashes = Crashes()
        self._ended = False
        self._killed = threading.Event()
        self.restarts = 0
        self.recycles = 0

    def start(self) -> None:
        """Start a worker and wait until it is ready.

        Raises:
            ConfigError: The configuration names something that does not exist.
            BackendUnavailableError: The backend cannot run there.
            WorkerLostError: The process died.
        """
        options = self._options
        self._worker = WorkerProcess(options.worker_python, self.log, self._memory.kill_bytes)
        if self._killed.is_set():
            self._worker.kill(_ENDING)
        _LOG.info("worker %d started", self._worker.pid)
        head = {
            "config": self._config,
            "state": self._state,
            "pose_cache_bytes": options.pose_cache_bytes,
            "asset_roots": [str(root) for root in options.asset_roots],
        }
        self._finish(START_METHOD, head, START_TIMEOUT_S)
        self._needed_bytes = 0
        self._on_ready(True)

    def call(
        self,
        method: str,
        request: bytes,
        *,
        timeout_s: float,
        cancelled: threading.Event,
        client: str = "",
    ) -> Iterator[WorkerMessage]:
        """Have the worker do something, starting a new worker first where there is none.

        Yields what the worker sends meanwhile, of the types ``progress`` and ``frames``, and at
        last its answer.

        Args:
            client: The connection that asks; a worker that is lost counts against it.

        Raises:
            WorkerLostError: The worker died meanwhile.
            DeadlyRequestError: The same request ended a worker before.
            CancelledError: The caller set ``cancelled``; whatever came later is dropped.
            DeadlineExceededError: It took more than ``timeout_s``.
            BackendUnavailableError: Workers died too often.
        """
        is_sample = method in SAMPLE_METHODS
        limit = CallLimit(timeout_s, self._options.grace_s, cancelled, worth_a_worker=is_sample)
        cause = Cause(client, self._digest(method, request))
        if (refusal := self._crashes.refusal(cause)) is not None:
            raise refusal
        self.ensure_worker()
        if limit.must_stop():
            raise limit.error()
        for answer in self._call(method, WorkerMessage({}, request), limit, cause):
            if answer.type != "answer":
                yield answer
        if limit.must_stop():
            if is_sample and "fault" not in answer.head:
                self.withdraw()
            raise limit.error()
        self._raise_fault(answer)
        if method in CHANGING_METHODS:
            self._crashes.note_success(cause, rendered=is_sample)
        if is_sample:
            self._breaker.note_success()
        yield answer

    def withdraw(self) -> None:
        """Have the worker undo its last sample, because its caller was told that it failed."""
        try:
            self._finish("withdraw_sample", {}, WITHDRAW_TIMEOUT_S)
        except OaisysError as error:
            _LOG.warning("a sample that came too late keeps its id: %s", error)

    def _call(
        self, method: str, request: WorkerMessage, limit: CallLimit, cause: Cause | None = None
    ) -> Iterator[WorkerMessage]:
        """Call the worker and remember the state of its world; drop a worker that is lost."""
        assert self._worker is not None
        try:
            for message in self._worker.call(method, request, limit):
                if message.type == "info":
                    self._info = pb.GetSimulatorInfoResponse.FromString(message.content)
                elif message.type != "answer":
                    yield message
        except (WorkerLostError, DeadlineExceededError) as error:
            if method != START_METHOD:
                self._note_loss(error, cause)
            raise
        except CancelledError as error:  # it would not stop
            self._drop(error)
            raise
        if method in SAMPLE_METHODS:
            self._needed_bytes = self._needed_bytes or self._worker.resident_bytes()
        self._keep(message)
        yield message

    def _finish(self, method: str, head: dict[str, Any], timeout_s: float) -> None:
        """Call the worker, and wait until it has succeeded."""
        limit = CallLimit(timeout_s, self._options.grace_s, threading.Event())
        *_, answer = self._call(method, WorkerMessage(head), limit)
        self._raise_fault(answer)

    def ensure_worker(self) -> None:
        """Start a new worker if the last one died or has grown too large; between two calls.

        Raises:
            BackendUnavailableError: Workers died too often.
            OaisysError: The new one does not start either.
        """
        self._replace_dead_worker()
        if self._worker is not None and self._has_grown(self._worker):
            # Health keeps saying that it serves: requests wait for the new worker.
            self.recycles += 1
            self._worker.end()
            self._worker = None
            self._start_another()

    def _replace_dead_worker(self) -> None:
        if self._worker is not None and not self._worker.alive:
            self._note_loss(WorkerLostError(f"idle: {self._worker.last_words()}"))
        if (refusal := self.refusal) is not None:
            raise refusal
        if self._worker is None:
            self.restarts += 1
            self._start_another()

    def _start_another(self) -> None:
        try:
            self.start()
        except (WorkerLostError, DeadlineExceededError) as error:
            self._note_loss(error)
            raise
        except OaisysError as error:
            self._on_ready(False)
            self._breaker.pause(error)
            raise

    def _has_grown(self, worker: WorkerProcess) -> bool:
        """Return whether the worker holds so much memory that another should replace it."""
        held = worker.resident_bytes()
        if not (self._needed_bytes and self._memory.outgrown(held, self._needed_bytes)):
            return False
        limit = self._memory.recycle_bytes
        _LOG.warning(
            "worker %d holds %.0f MB of memory, and %.0f MB are its limit: another one goes on",
            worker.pid,
            held / MEGABYTE,
            limit / MEGABYTE,
        )
        return True

    @property
    def refusal(self) -> BackendUnavailableError | None:
        """Why no worker runs, and when one will; None if one runs or is being started."""
        if self._ended:
            return BackendUnavailableError("no worker runs any more: the simulator has been ended")
        return self._breaker.refusal

    @property
    def info(self) -> pb.GetSimulatorInfoResponse:
        """What the worker last said of the simulator; it must not be changed."""
        if self._info is None:
            raise BackendUnavailableError("no worker has been ready yet")
        return self._info

    def end(self) -> None:
        """End the worker for good."""
        self._on_ready(False)
        self._ended = True
        if self._worker is not None:
            self._worker.end()
        self.log.close()

    def kill(self) -> None:
        """Kill the worker, and any that follows it, at once; any thread may call this."""
        self._killed.set()
        worker = self._worker
        if worker is not None:
            worker.kill(_ENDING)

    def _keep(self, answer: WorkerMessage) -> None:
        """Remember the state of the world that an answer brings."""
        head = answer.head
        if "state" in head:
            self._state = head["state"]
            info = pb.GetSimulatorInfoResponse()
            info.CopyFrom(self.info)
            info.batch_id, info.sample_id = head["batch_id"], head["sample_id"]
            info.ClearField("rig_pose")
            if head["rig_pose"] is not None:
                info.rig_pose.CopyFrom(pose_to_proto(Pose(**head["rig_pose"])))
            self._info = info

    @staticmethod
    def _raise_fault(answer: WorkerMessage) -> None:
        """Raise the error that an answer brings, if it brings one."""
        if "fault" in answer.head:
            raise error_from_fault(Fault(**answer.head["fault"]))

    def _drop(self, error: OaisysError) -> None:
        """Forget a worker that was lost."""
        _LOG.error("%s (what workers print: %s)", error, self.log.path or "not kept")
        self._on_ready(False)
        if self._worker is not None:
            self._worker.discard()
            self._worker = None

    def _note_loss(self, error: OaisysError, cause: Cause | None = None) -> None:
        self._drop(error)
        if cause is None:
            self._breaker.note_crash(error)
        elif self._crashes.note_crash(cause, error):
            self._breaker.pause(error)

    def _digest(self, method: str, request: bytes) -> bytes:
        """Return what is equal for requests that do the same, in the same world."""
        batch_id = 0 if self._info is None or method == BATCH_METHOD else self._info.batch_id
        return hashlib.sha256(f"{method} {batch_id} ".encode() + request).digest()
