"""The bridge's connection to the simulator: monitored by a thread, restored when it was lost."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue

from oaisys_core.errors import (
    ConfigError,
    DeadlineExceededError,
    InvalidInputError,
    NotReadyError,
    OaisysError,
    RenderError,
    WorkerLostError,
    WorkerStartingError,
)
from oaisys_core.types import SimulatorInfo
from oaisys_grpc.client.simulator_client import ClientTls, SimulatorClient
from oaisys_ros_bridge.bridge.link_state import LinkChange, LinkState, RebuildPauses

CHECK_PERIOD_S = 2.0
"""Between two checks of a server that answers."""
FIRST_RETRY_S = 0.2
LONGEST_RETRY_S = 0.5
HEALTH_TIMEOUT_S = 5.0

_WORLD_ERRORS = (RenderError, InvalidInputError, ConfigError)
"""Errors of the world, not of the connection: the next attempt probably fails, too."""


class SimulatorConnection:
    """Keeps a client connected to ``address`` and, if wanted, builds the first batch.

    A thread looks for the server, with growing pauses while there is none, and checks it every
    `CHECK_PERIOD_S` afterwards. A first batch that cannot be built is tried again after pauses that
    grow, see `RebuildPauses`.

    Args:
        address: ``host:port`` or ``unix:PATH``.
        initial_batch: See the attribute.
        timeout_s: How long a call may take.
        on_change: Called after a change was put into `changes`, on any thread; must not block.
        tls: For a server that encrypts; None: without.

    Attributes:
        initial_batch: Whether to build a first batch where there is none.
        building: Whether a batch is being built.
        lock: Held by whoever lets the rig move, drives or checks the server.
        changes: Changes of the state, for one reader.
        config_json: The server's configuration; empty: the server was not found yet, or is too old
            to send it.
        first_batch_error: Why the first batch could not be built, in two tries; empty: it could.
        first_batch_retried_after: Why the first of these tries failed; empty: it did not.
    """

    def __init__(
        self,
        address: str,
        *,
        initial_batch: bool,
        timeout_s: float,
        on_change: Callable[[], object],
        tls: ClientTls | None = None,
    ) -> None:
        self.address = address
        self._tls = tls
        self.initial_batch = initial_batch
        self.config_json = self._config_sha256 = ""
        self.building = False
        self.changes: SimpleQueue[LinkChange] = SimpleQueue()
        self.first_batch_error = self.first_batch_retried_after = ""
        self._rebuilds = RebuildPauses()
        self._timeout_s = timeout_s
        self._on_change = on_change
        self._state = LinkState(None, f"no simulator serves at {address}", 0)
        self._client: SimulatorClient | None = None
        self.lock = threading.RLock()
        self._changed = threading.Condition()
        self._stopping = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="simulator_link", daemon=True)

    def start(self) -> None:
        """Start the thread that looks for the server."""
        self._thread.start()

    def close(self) -> None:
        """Disconnect; calls under way end with an error."""
        self._stopping.set()
        self._wake.set()
        self.wake_waiters()
        if self._client is not None:
            self._client.close()
        if self._thread.is_alive():
            self._thread.join(timeout=HEALTH_TIMEOUT_S)

    @property
    def state(self) -> LinkState:
        """What is known now."""
        return self._state

    @property
    def info(self) -> SimulatorInfo:
        """The server's description.

        Raises:
            NotReadyError: It does not answer.
        """
        state = self._state
        if state.info is None:
            raise NotReadyError(state.reason)
        return state.info

    def wait_for_worker(self, is_cancelled: Callable[[], bool] = lambda: False) -> None:
        """Look for a simulator that was lost; while it starts its worker, wait for that.

        Args:
            is_cancelled: Whether to wait no longer; looked at after `wake_waiters`.

        Raises:
            OaisysError: Nobody answers, or no worker will be started soon.
            DeadlineExceededError: The worker was not ready in time.
        """
        if self._state.info is None or self._state.is_starting:
            self.find_worker(is_cancelled)

    def find_worker(self, is_cancelled: Callable[[], bool] = lambda: False) -> None:
        """Ask the server for its state; while it starts its worker, wait for that.

        Args:
            is_cancelled: See `wait_for_worker`.

        Raises:
            OaisysError: See `wait_for_worker`.
        """
        if not self._state.is_starting:
            with self.lock:
                try:
                    self.check()
                except WorkerStartingError as error:
                    self.lose(error)
                else:
                    return

        def is_over() -> bool:
            is_starting = self._state.is_starting
            return not is_starting or self._stopping.is_set() or is_cancelled()

        with self._changed:
            in_time = self._changed.wait_for(is_over, self._timeout_s)
        reason = self._state.reason
        if not in_time:
            raise DeadlineExceededError(f"{reason}, and was not ready within {self._timeout_s:g} s")
        if self._state.info is None and not is_cancelled():
            raise NotReadyError(reason)

    def wake_waiters(self) -> None:
        """Have `wait_for_worker` look whether it is cancelled."""
        with self._changed:
            self._changed.notify_all()

    @contextmanager
    def lend_client(self, *, waits: bool = True) -> Iterator[SimulatorClient]:
        """Lend the client, and learn from the errors of its calls.

        Args:
            waits: Whether to wait for a worker that is being started; not with the lock held.
        """
        if waits:
            self.wait_for_worker()
        if self._client is None:
            self.check()
        client = self._client
        if client is None:
            raise NotReadyError(self._state.reason)
        try:
            yield client
        except InvalidInputError:
            raise
        except OaisysError as error:
            if isinstance(error, WorkerLostError):
                with self.lock:
                    known = self._state
                    self._change(LinkState(known.info, str(error), known.connections, True))
            self._wake.set()
            raise

    def _watch(self) -> None:
        retry_s = FIRST_RETRY_S
        while not self._stopping.is_set():
            # A render under way tells more about the server than a check during the render.
            if self.lock.acquire(blocking=False):
                try:
                    self.check()
                    retry_s = FIRST_RETRY_S
                except OaisysError as error:
                    self.lose(error)
                    retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)
                finally:
                    self.lock.release()
            self._wake.wait(CHECK_PERIOD_S if self._state.info is not None else retry_s)
            self._wake.clear()

    def find(self) -> SimulatorInfo:
        """Return the server's description, before `start`; build nothing.

        Raises:
            OaisysError: It does not answer.
        """
        _, info = self._find()
        self._state = LinkState(info, "no sample can be asked for yet", 1)
        return info

    def _find(self) -> tuple[SimulatorClient, SimulatorInfo]:
        if self._client is None:
            self._client = SimulatorClient(self.address, timeout_s=self._timeout_s, tls=self._tls)
        client = self._client
        client.check_ready(HEALTH_TIMEOUT_S)
        info = client.info()
        if info.config_sha256 != self._config_sha256:
            self.config_json, self._config_sha256 = client.config_json(), info.config_sha256
            self._rebuilds.try_now()
        return client, info

    def check(self) -> None:
        """Ask the server for its state, and build the first batch where there is none.

        Waits for the end of a sample that is being rendered.

        Raises:
            OaisysError: It does not answer, or cannot build.
        """
        with self.lock:
            client, info = self._find()
            if self._should_build(info):
                self._build_first_batch(client, info)
                info = client.info()
            if info.batch_id > 0:
                self.first_batch_error, self._rebuilds = "", RebuildPauses()
            if self._state.info is not None and self._state.ready:
                restarts = info.worker_restarts - self._state.info.worker_restarts
                if restarts > 0:
                    self._enter(info, f"the simulator's worker died; restarted {restarts} time(s)")
            nothing = self.first_batch_error or "no batch has been stepped yet"
            self._enter(info, "" if info.batch_id > 0 else nothing)

    def _should_build(self, info: SimulatorInfo) -> bool:
        """Return whether there is no first batch, one is wanted, and it is time to try."""
        if self._state.info is None:  # another server, perhaps
            self._rebuilds.try_now()
        return info.batch_id == 0 and self.initial_batch and self._rebuilds.is_due()

    def _build_first_batch(self, client: SimulatorClient, info: SimulatorInfo) -> None:
        """Build it, and try once more if that failed: the next worker may succeed.

        If the world is at fault, note why, and when to try again.

        Raises:
            OaisysError: It failed twice, for another reason.
        """
        self.first_batch_retried_after = ""
        self._enter(info, "the first batch is being built")
        with self.note_building():
            try:
                client.step_batch()
            except OaisysError as error:
                if self._stopping.is_set():
                    raise
                self.first_batch_retried_after = str(error)
                self._enter(info, f"the first batch failed and is built once more: {error}")
                try:
                    client.step_batch()
                except OaisysError as second:
                    self.first_batch_error = f"the first batch could not be built, twice: {second}"
                    if not isinstance(second, _WORLD_ERRORS):
                        raise
                    self._rebuilds.wait_longer()

    @contextmanager
    def note_building(self) -> Iterator[None]:
        """Say in `building`, during a ``with`` block, that a batch is being built."""
        self.building = True
        try:
            yield
        finally:
            self.building = False

    def _enter(self, info: SimulatorInfo | None, reason: str) -> None:
        found = int(self._state.info is None and info is not None)
        self._change(LinkState(info, reason, self._state.connections + found))

    def lose(self, reason: OaisysError) -> None:
        """Drop the client: a new one connects without the back-off of the old channel."""
        client, self._client = self._client, None
        if client is not None:
            client.close()
        is_starting = isinstance(reason, WorkerStartingError)
        self._change(LinkState(None, str(reason), self._state.connections, is_starting))

    def _change(self, state: LinkState) -> None:
        before, self._state = self._state, state
        self.wake_waiters()
        if not self._stopping.is_set():
            self.changes.put(LinkChange(before, state))
            self._on_change()
