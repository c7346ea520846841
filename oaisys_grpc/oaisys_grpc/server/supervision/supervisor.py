"""Keeps a worker running: replaces one that died, with its world restored."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from oaisys_core.config import SimulationConfig, canonical_json
from oaisys_core.errors import (
    BackendUnavailableError,
    CancelledError,
    DeadlineExceededError,
    OaisysError,
    WorkerLostError,
)
from oaisys_core.types import (
    Progress,
    SampleFramesCallback,
    SimulatorInfo,
    ignore_progress,
    ignore_sample_frames,
)
from oaisys_grpc.contract.faults import Fault, error_from_fault
from oaisys_grpc.server.options import ServerOptions
from oaisys_grpc.server.supervision.breaker import Breaker
from oaisys_grpc.server.supervision.call_limit import Limit
from oaisys_grpc.server.supervision.worker_log import WorkerLog
from oaisys_grpc.server.supervision.worker_memory import MEGABYTE, MemoryLimits
from oaisys_grpc.server.supervision.worker_process import WorkerProcess
from oaisys_grpc.worker.protocol import Message

_LOG = logging.getLogger(__name__)

START_TIMEOUT_S = 300.0
"""For a worker to load Blender and to build the world that stood before."""

WITHDRAW_TIMEOUT_S = 10.0
"""For a worker to bring back what was before a sample."""


_ENDING = "the server was told to end"

SAMPLE_METHOD = "step_sample"
"""What the worker calls rendering; the only call that is worth a new worker to stop."""


class Supervisor:
    """Owns the worker process and all that is known of it.

    All but `info` and `strike` belong to one thread, which must live as long as the worker.
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
            on_ready: Told when a worker is ready, and when none is.
        """
        self._config: Message = config.model_dump(mode="json")
        self.config_json = canonical_json(config)
        self._options = options
        self._memory = MemoryLimits.of(options.worker_memory_bytes)
        self._on_ready = on_ready
        self.log = WorkerLog()
        self._worker: WorkerProcess | None = None
        self._needed_bytes = 0
        self._state: str | None = None
        self._info: SimulatorInfo | None = None
        self._breaker = Breaker()
        self._ended = False
        self._struck = threading.Event()
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
        if self._struck.is_set():
            self._worker.strike(_ENDING)
        _LOG.info("worker %d started", self._worker.pid)
        limit = Limit(START_TIMEOUT_S, options.grace_s, threading.Event())
        arguments = {
            "config": self._config,
            "state": self._state,
            "pose_cache_bytes": options.pose_cache_bytes,
            "asset_roots": [str(root) for root in options.asset_roots],
        }
        answer = self._worker.call("start", arguments, limit=limit, progress=ignore_progress)
        self._take(answer)
        self._needed_bytes = 0
        self._on_ready(True)

    def call(
        self,
        method: str,
        arguments: Mapping[str, Any],
        *,
        timeout_s: float,
        cancelled: threading.Event,
        progress: Callable[[Progress], None] = ignore_progress,
        on_frames: SampleFramesCallback = ignore_sample_frames,
    ) -> Any:
        """Have the worker do something, starting a new worker first where there is none.

        Raises:
            WorkerLostError: The worker died meanwhile.
            CancelledError: The caller set ``cancelled``; whatever came later is dropped.
            DeadlineExceededError: It took more than ``timeout_s``.
            BackendUnavailableError: Workers died too often.
        """
        is_sample = method == SAMPLE_METHOD
        limit = Limit(timeout_s, self._options.grace_s, cancelled, worth_a_worker=is_sample)
        self.tend()
        if limit.must_stop():
            raise limit.error()
        answer = self._answer_of(method, arguments, limit, progress, on_frames)
        failure: OaisysError | None = None
        try:
            self._take(answer)
        except OaisysError as error:
            failure = error
        if limit.must_stop():
            if failure is None and is_sample:
                self.withdraw()
            raise limit.error()
        if failure is not None:
            raise failure
        if is_sample:
            self._breaker.worked()
        return answer["value"]

    def withdraw(self) -> None:
        """Have the worker undo the sample that it just made: its caller was told that it failed."""
        limit = Limit(WITHDRAW_TIMEOUT_S, self._options.grace_s, threading.Event())
        try:
            self._take(
                self._answer_of("withdraw_sample", {}, limit, ignore_progress, ignore_sample_frames)
            )
        except OaisysError as error:
            _LOG.warning("a sample that came too late keeps its id: %s", error)

    def _answer_of(
        self,
        method: str,
        arguments: Mapping[str, Any],
        limit: Limit,
        progress: Callable[[Progress], None],
        on_frames: SampleFramesCallback,
    ) -> Message:
        assert self._worker is not None
        try:
            answer = self._worker.call(
                method, arguments, limit=limit, progress=progress, on_frames=on_frames
            )
        except (WorkerLostError, DeadlineExceededError) as error:
            self._lost(error)
            raise
        except CancelledError as error:  # it would not stop
            self._drop(error)
            raise
        if method == SAMPLE_METHOD:
            self._needed_bytes = self._needed_bytes or self._worker.resident_bytes()
        return answer

    def tend(self) -> None:
        """Start a new worker where the last one died, or has grown too large; between two calls.

        Raises:
            BackendUnavailableError: Workers died too often.
            OaisysError: The new one does not start either.
        """
        self._see_to_worker()
        if self._worker is not None and self._has_grown(self._worker):
            # Health goes on to say that it serves: what is asked for meanwhile waits, and is done.
            self.recycles += 1
            self._worker.end()
            self._worker = None
            self._start_another()

    def _see_to_worker(self) -> None:
        if self._worker is not None and not self._worker.alive:
            self._lost(WorkerLostError(f"idle: {self._worker.last_words()}"))
        if (refusal := self.refusal) is not None:
            raise refusal
        if self._worker is None:
            self.restarts += 1
            self._start_another()

    def _start_another(self) -> None:
        try:
            self.start()
        except (WorkerLostError, DeadlineExceededError) as error:
            self._lost(error)
            raise
        except OaisysError as error:
            self._on_ready(False)
            self._breaker.pause(error)
            raise

    def _has_grown(self, worker: WorkerProcess) -> bool:
        """Return whether the worker, which is between two frames, should make room for another."""
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
        """Why no worker runs, and when one will; None where one does, or is being started."""
        if self._ended:
            return BackendUnavailableError("no worker runs any more: the simulator has been ended")
        return self._breaker.refusal

    @property
    def info(self) -> SimulatorInfo:
        """What the simulator was when it last said so."""
        if self._info is None:
            raise BackendUnavailableError("no worker has been ready yet")
        return self._info

    def end(self) -> None:
        """End the worker; none is started any more."""
        self._on_ready(False)
        self._ended = True
        if self._worker is not None:
            self._worker.end()
        self.log.close()

    def strike(self) -> None:
        """Kill the worker at once, and any that follows; any thread may."""
        self._struck.set()
        worker = self._worker
        if worker is not None:
            worker.strike(_ENDING)

    def _take(self, answer: Message) -> None:
        """Keep what the answer says of the world; raise the error that it brings."""
        if "state" in answer:
            self._state = answer["state"]
            info: SimulatorInfo = answer.get("info") or self.info
            self._info = replace(info, batch_id=answer["batch_id"], sample_id=answer["sample_id"])
        if "fault" in answer:
            raise error_from_fault(Fault(**answer["fault"]))

    def _drop(self, error: OaisysError) -> None:
        """Do without a worker that is no more."""
        _LOG.error("%s (what workers print: %s)", error, self.log.path or "not kept")
        self._on_ready(False)
        if self._worker is not None:
            self._worker.kill()
            self._worker = None

    def _lost(self, error: OaisysError) -> None:
        self._drop(error)
        self._breaker.crashed(error)
