"""The bridge's connection to the simulator: found in the background, lost and found again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from oaisys_core.errors import InvalidInputError, NotReadyError, OaisysError, WorkerLostError
from oaisys_core.types import (
    ModuleMetadata,
    ObjectPage,
    ObjectQuery,
    Pose,
    Sample,
    SampleFramesCallback,
    SimulatorInfo,
)
from oaisys_grpc.client.simulator_client import ClientTls, SimulatorClient
from oaisys_ros_bridge.bridge.cancellation import Cancellation
from oaisys_ros_bridge.bridge.turns import Turns

R = TypeVar("R")

CHECK_PERIOD_S = 2.0
"""Between two looks at a server that answers."""
FIRST_RETRY_S = 0.2
LONGEST_RETRY_S = 1.0
HEALTH_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class LinkState:
    """What is known of the server.

    Attributes:
        info: The server's own description; None while it does not answer.
        reason: Why it is not ready; empty when it is.
        connections: How often the server was found so far.
    """

    info: SimulatorInfo | None
    reason: str
    connections: int

    @property
    def ready(self) -> bool:
        """Whether a sample could be rendered now."""
        return self.info is not None and not self.reason


class SimulatorLink:
    """Keeps a client connected to ``address`` and, if wanted, a batch standing.

    A thread looks for the server, with growing pauses while there is none, and asks it every
    `CHECK_PERIOD_S` afterwards. Calls that render go one at a time, each in its turn.

    Attributes:
        initial_batch: Whether to build a first batch where there is none.
        building: Whether a batch is being built.
        config_json: The server's configuration; empty: it was not found yet, or does not say.
        first_batch_error: Why there is no first batch although it was tried twice; empty: no
            such thing.
        first_batch_retried_after: What the first of these tries failed of; empty: it did not.
    """

    def __init__(
        self,
        address: str,
        turns: Turns,
        *,
        initial_batch: bool,
        timeout_s: float,
        on_change: Callable[[LinkState, LinkState], None],
        tls: ClientTls | None = None,
    ) -> None:
        self.address = address
        self._tls = tls
        self.initial_batch = initial_batch
        self.config_json = self._config_sha256 = ""
        self.building = False
        self.first_batch_error = self.first_batch_retried_after = ""
        self._turns = turns
        self._timeout_s = timeout_s
        self._on_change = on_change
        self._state = LinkState(None, f"no simulator at {address} yet", 0)
        self._client: SimulatorClient | None = None
        self._stopping = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="simulator_link", daemon=True)

    def start(self) -> None:
        """Begin to look for the server."""
        self._thread.start()

    def close(self) -> None:
        """Let go of the server; calls under way end with an error."""
        self._stopping.set()
        self._wake.set()
        if self._client is not None:
            self._client.close()
        if self._thread.is_alive():
            self._thread.join(timeout=HEALTH_TIMEOUT_S)

    @property
    def state(self) -> LinkState:
        """What is known now."""
        return self._state

    def render(
        self,
        pose: Pose | None,
        *,
        metadata: ModuleMetadata | None,
        modalities: Sequence[str],
        sensors: Sequence[str],
        on_frames: SampleFramesCallback,
        cancellation: Cancellation,
    ) -> Sample:
        """Render a sample; a server that has started afresh gets its first batch before that.

        Args:
            on_frames: Told frames as soon as they come; see `SimulatorClient.render_sample`.
            cancellation: Stops the render.

        Raises:
            OaisysError: As the server says, or there is none.
        """

        def call(client: SimulatorClient) -> Sample:
            view = client.stream_sample(
                pose, metadata=metadata, modalities=modalities, sensors=sensors
            )
            with view as stream, cancellation.stopping_by(stream.cancel):
                for frame in stream:
                    on_frames(stream.outline, (frame,))
                return stream.sample

        with self._turns:
            try:
                return self._call(call)
            except NotReadyError:
                if not self.initial_batch or self._stopping.is_set():
                    raise
                self.check()
                return self._call(call)

    def step_batch(
        self, *, seed: int | None, reuse_stage: bool, metadata: ModuleMetadata | None
    ) -> int:
        """Build a new batch and return its id; it overtakes a sample that renders."""
        with self._is_building():
            batch_id = self._call(
                lambda client: client.step_batch(
                    seed=seed, reuse_stage=reuse_stage, metadata=metadata
                )
            )
        with self._turns:
            self.check()
        return batch_id

    def list_objects(self, query: ObjectQuery, metadata: ModuleMetadata | None) -> ObjectPage:
        """Return things of the world, as they will be after ``metadata``; changes nothing.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        return self._call(lambda client: client.list_objects(query, metadata))

    def end_simulation(self) -> None:
        """End the server's process."""
        with self._turns:
            self._call(lambda client: client.end_simulation())
            self._lose("the simulation was ended")

    def _call(self, call: Callable[[SimulatorClient], R]) -> R:
        if self._client is None:
            with self._turns:
                self.check()
        client = self._client
        if client is None:
            raise NotReadyError(self._state.reason)
        try:
            return call(client)
        except InvalidInputError:
            raise
        except WorkerLostError as error:
            with self._turns:
                self._enter(self._state.info, str(error))
            self._wake.set()
            raise
        except OaisysError:
            self._wake.set()
            raise

    def _watch(self) -> None:
        retry_s = FIRST_RETRY_S
        while not self._stopping.is_set():
            # A render under way tells more about the server than a look at it beside the render.
            if self._turns.acquire(blocking=False):
                try:
                    self.check()
                    retry_s = FIRST_RETRY_S
                except OaisysError as error:
                    self._lose(str(error))
                    retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)
                finally:
                    self._turns.release()
            self._wake.wait(CHECK_PERIOD_S if self._state.info is not None else retry_s)
            self._wake.clear()

    def look(self) -> SimulatorInfo:
        """Return what the simulator is, before `start`; build nothing.

        Raises:
            OaisysError: It does not answer.
        """
        _, info = self._found()
        self._state = LinkState(info, "no sample can be asked for yet", 1)
        return info

    def _found(self) -> tuple[SimulatorClient, SimulatorInfo]:
        if self._client is None:
            self._client = SimulatorClient(self.address, timeout_s=self._timeout_s, tls=self._tls)
        client = self._client
        if not client.is_ready(HEALTH_TIMEOUT_S):
            raise NotReadyError(f"no simulator serves at {self.address}")
        info = client.info()
        if info.config_sha256 != self._config_sha256:
            self.config_json, self._config_sha256 = client.config_json(), info.config_sha256
        return client, info

    def check(self) -> None:
        """Ask the server what it is, and build the first batch where there is none.

        Raises:
            OaisysError: It does not answer, or cannot build.
        """
        client, info = self._found()
        if info.batch_id == 0 and self.initial_batch:
            self._build_first_batch(client, info)
            info = client.info()
        if self._state.info is not None and self._state.ready:
            restarts = info.worker_restarts - self._state.info.worker_restarts
            if restarts > 0:
                self._enter(info, f"the simulator's worker died; restarted {restarts} time(s)")
        self._enter(info, "" if info.batch_id > 0 else "no batch has been stepped yet")

    def _build_first_batch(self, client: SimulatorClient, info: SimulatorInfo) -> None:
        """Build it, once more where that failed: the next worker may have more luck.

        Raises:
            OaisysError: It failed twice.
        """
        self.first_batch_retried_after = ""
        self._enter(info, "the first batch is being built")
        with self._is_building():
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
                    raise
        self.first_batch_error = ""

    @contextmanager
    def _is_building(self) -> Iterator[None]:
        self.building = True
        try:
            yield
        finally:
            self.building = False

    def _enter(self, info: SimulatorInfo | None, reason: str) -> None:
        found = int(self._state.info is None and info is not None)
        self._change(LinkState(info, reason, self._state.connections + found))

    def _lose(self, reason: str) -> None:
        """Forget the server; a new client starts without the old channel's long pauses."""
        client, self._client = self._client, None
        if client is not None:
            client.close()
        self._change(LinkState(None, reason, self._state.connections))

    def _change(self, state: LinkState) -> None:
        before, self._state = self._state, state
        if not self._stopping.is_set():
            self._on_change(before, state)
