"""Keeps a worker running: replaces one that died, with its world restored."""

from __future__ import annotations

import collections
import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import (
    BackendUnavailableError,
    DeadlineExceededError,
    OaisysError,
    WorkerLostError,
)
from oaisys_core.types import Progress, SimulatorInfo
from oaisys_grpc.faults import Fault, error_from_fault
from oaisys_grpc.wire import Message
from oaisys_grpc.worker_process import Limit, WorkerProcess

_LOG = logging.getLogger(__name__)

START_TIMEOUT_S = 300.0
"""For a worker to load Blender and to build the world that stood before."""

GRACE_S = 30.0
"""Between a call's deadline, when it is cancelled, and the end of a worker that hangs."""

CRASHES_ALLOWED = 3
CRASH_WINDOW_S = 60.0
"""So many crashes within so many seconds, and no new worker is started."""


def ignore_progress(progress: Progress) -> None:
    """Do nothing with it."""


class Supervisor:
    """Owns the worker process and all that is known of it.

    All but `info` and `strike` belong to one thread, which must live as long as the worker.
    """

    def __init__(
        self,
        config: SimulationConfig,
        python: str,
        on_ready: Callable[[bool], None],
        grace_s: float = GRACE_S,
    ) -> None:
        """Start nothing yet.

        Args:
            python: Interpreter of the worker.
            on_ready: Told when a worker is ready, and when none is.
            grace_s: How long after its deadline a worker that hangs is killed.
        """
        self._config: Message = config.model_dump(mode="json")
        self._python = python
        self._on_ready = on_ready
        self._grace_s = grace_s
        self._worker: WorkerProcess | None = None
        self._state: Message | None = None
        self._info: SimulatorInfo | None = None
        self._crashes_s: collections.deque[float] = collections.deque(maxlen=CRASHES_ALLOWED)
        self._broken: OaisysError | None = None
        self.restarts = 0

    def start(self, cancelled: threading.Event | None = None) -> None:
        """Start a worker and wait until it is ready.

        Raises:
            ConfigError: The configuration names something that does not exist.
            BackendUnavailableError: The backend cannot run there.
            WorkerLostError: The process died.
        """
        self._worker = WorkerProcess(self._python)
        _LOG.info("worker %d started", self._worker.pid)
        limit = Limit(START_TIMEOUT_S, self._grace_s, cancelled or threading.Event())
        arguments = {"config": self._config, "state": self._state}
        answer = self._worker.call("start", arguments, limit=limit, progress=ignore_progress)
        self._take(answer)
        self._on_ready(True)

    def call(
        self,
        method: str,
        arguments: Mapping[str, Any],
        *,
        timeout_s: float,
        cancelled: threading.Event,
        progress: Callable[[Progress], None] = ignore_progress,
    ) -> Any:
        """Have the worker do something, starting a new worker first where there is none.

        Raises:
            WorkerLostError: The worker died meanwhile.
            CancelledError: The caller set ``cancelled``; whatever came later is dropped.
            DeadlineExceededError: It took more than ``timeout_s``.
            BackendUnavailableError: Workers died too often.
        """
        self.tend()
        limit = Limit(timeout_s, self._grace_s, cancelled)
        assert self._worker is not None
        try:
            answer = self._worker.call(method, arguments, limit=limit, progress=progress)
        except (WorkerLostError, DeadlineExceededError) as error:
            self._lost(error)
            raise
        failure: OaisysError | None = None
        try:
            self._take(answer)
        except OaisysError as error:
            failure = error
        if limit.must_stop():
            raise limit.error()
        if failure is not None:
            raise failure
        return answer["value"]

    def tend(self) -> None:
        """Start a new worker where the last one died.

        Raises:
            BackendUnavailableError: Workers died too often.
            OaisysError: The new one does not start either.
        """
        if self._worker is not None and not self._worker.alive:
            self._lost(WorkerLostError(f"idle: {self._worker.last_words()}"))
        if self._broken is not None:
            raise BackendUnavailableError(f"no worker runs any more: {self._broken}")
        if self._worker is None:
            self.restarts += 1
            try:
                self.start()
            except (WorkerLostError, DeadlineExceededError) as error:
                self._lost(error)
                raise
            except OaisysError as error:
                self._broken = error
                raise

    @property
    def info(self) -> SimulatorInfo:
        """What the simulator was when it last said so."""
        if self._info is None:
            raise BackendUnavailableError("no worker has been ready yet")
        return self._info

    def end(self) -> None:
        """End the worker; none is started any more."""
        self._on_ready(False)
        self._broken = self._broken or BackendUnavailableError("the simulator has been ended")
        if self._worker is not None:
            self._worker.end()

    def strike(self) -> None:
        """Kill the worker at once; any thread may."""
        worker = self._worker
        if worker is not None:
            worker.strike()

    def _take(self, answer: Message) -> None:
        """Keep what the answer says of the world; raise the error that it brings."""
        if "state" in answer:
            self._state, self._info = answer["state"], answer["info"]
        if "fault" in answer:
            raise error_from_fault(Fault(**answer["fault"]))

    def _lost(self, error: OaisysError) -> None:
        _LOG.error("%s", error)
        self._on_ready(False)
        if self._worker is not None:
            self._worker.kill()
            self._worker = None
        now_s = time.monotonic()
        self._crashes_s.append(now_s)
        oldest_s = self._crashes_s[0]
        if len(self._crashes_s) == CRASHES_ALLOWED and now_s - oldest_s < CRASH_WINDOW_S:
            self._broken = error
            _LOG.error("%d crashes within %g s: giving up", CRASHES_ALLOWED, CRASH_WINDOW_S)
