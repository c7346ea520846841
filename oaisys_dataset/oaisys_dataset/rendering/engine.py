"""Renders the worlds of a data set on Ray, and writes their shards.

Each world is one task of Ray. Ray places it on a node with a free core and enough memory, and runs
it again if its worker or its node dies. A task yields the world's views one by one. The driver
writes them into the world's shard; if the data set is at a URL that all machines can reach, the
worker does, and no image passes through the driver.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from oaisys_core.config import SimulationConfig, canonical_json
from oaisys_core.errors import ConfigError, OaisysError, RenderError
from oaisys_dataset.manifest import WorldFailure, WorldLegend
from oaisys_dataset.places import StoragePlace
from oaisys_dataset.plan import WorldTask
from oaisys_dataset.rendering.ray_session import WORKER_START_S, RaySession, ray_session
from oaisys_dataset.rendering.ray_settings import RaySettings
from oaisys_dataset.rendering.workers import (
    SetupFailure,
    ViewCounts,
    WorldBegun,
    WorldPart,
    WrittenPart,
    render_world,
    write_world,
)
from oaisys_dataset.shards import failure_name, write_failure

MEMORY_SCHEME = "memory://"
"""URLs of data sets in the memory of one process: only the driver can write there."""

LOOK_S = 5.0
"""Longest time without an event."""


class Waiting(NamedTuple):
    """Nothing happened for `LOOK_S`; this many worlds are being rendered."""

    worlds: int


class WorldFinished(NamedTuple):
    """The shard of a world is whole; ``labels`` are its labels by id."""

    world: int
    labels: Mapping[int, str]


DatasetEvent = WorldBegun | ViewCounts | WorldFinished | WorldFailure | Waiting
"""What happens while a data set is rendered."""


def render_worlds(
    place: StoragePlace, config: SimulationConfig, tasks: Iterable[WorldTask], settings: RaySettings
) -> Iterator[DatasetEvent]:
    """Render worlds, write their shards or why they failed, and yield what happens.

    Raises:
        RenderError: A shard could not be written, for instance because the disk is full.
        ConfigError: No worker can render this configuration.
        InvalidInputError: Ray cannot be used as the settings say.
        OaisysError: Ray itself failed.
    """
    with ray_session(settings) as session:
        queue = _WorldQueue(session, place, config, settings)
        try:
            yield from queue.run(iter(tasks))
        except session.ray.exceptions.RayError as error:
            raise OaisysError(f"Ray failed: {_first_line(error)}") from error
        finally:
            queue.abandon()


_Parts = Generator[WorldBegun | WrittenPart, None, None]


class _WorldQueue:
    """The worlds that are being rendered, as many as there are workers."""

    def __init__(
        self,
        session: RaySession,
        place: StoragePlace,
        config: SimulationConfig,
        settings: RaySettings,
    ) -> None:
        self._session = session
        self._ray = session.ray
        self._place = place
        self._config_json = session.ray.put(canonical_json(config))
        is_shared = place.folder is None and not place.url.startswith(MEMORY_SCHEME)
        self._url = place.url if is_shared else None
        self._retries = settings.retries
        self._render = settings.remote(session.ray, render_world)
        self._waiting: Iterator[WorldTask] = iter(())
        self._rendering = 0
        self._has_begun = False
        self._parts: dict[Any, _Parts] = {}
        self._tasks: dict[Any, WorldTask] = {}

    def run(self, tasks: Iterator[WorldTask]) -> Iterator[DatasetEvent]:
        """Render all worlds."""
        self._waiting = tasks
        begin_until_s = time.monotonic() + WORKER_START_S
        self._start_worlds()
        while self._parts:
            ready, _ = self._ray.wait(
                list(self._parts), num_returns=1, timeout=LOOK_S, fetch_local=False
            )
            if not ready:
                self._check_begun(begin_until_s)
                yield Waiting(len(self._parts))
            for stream in ready:
                yield from self._advance(stream)

    def _check_begun(self, until_s: float) -> None:
        """Raise if no worker has begun by a moment; on a cluster, others may use all cores.

        Raises:
            OaisysError: None has.
        """
        is_embedded = self._session.folder is not None
        if is_embedded and not self._has_begun and time.monotonic() > until_s:
            reason = f"no worker of Ray has begun within {WORKER_START_S:g} s"
            raise self._session.start_error(reason)

    def abandon(self) -> None:
        """Give up the worlds that are not finished, and remove their unfinished shards."""
        while self._parts:
            _, parts = self._parts.popitem()
            parts.close()

    def _start_worlds(self) -> None:
        while self._rendering < self._session.workers:
            task = next(self._waiting, None)
            if task is None:
                return
            stream = self._render.remote(self._config_json, task, self._url)
            self._rendering += 1
            self._tasks[stream] = task
            self._parts[stream] = self._follow_parts(stream, task)

    def _advance(self, stream: Any) -> Iterator[DatasetEvent]:
        """Take the next part of a world, and yield what follows from it."""
        part = next(self._parts[stream])
        self._has_begun = True
        if isinstance(part, WorldBegun | ViewCounts):
            yield part
            return
        task = self._tasks.pop(stream)
        self._parts.pop(stream).close()
        if isinstance(part, WorldFailure):
            write_failure(self._place, part)
            yield part
        else:
            self._place.delete(failure_name(task.index))
            yield WorldFinished(task.index, part.labels)

    def _follow_parts(self, stream: Any, task: WorldTask) -> _Parts:
        """Yield the parts of a world when they are written, by the worker or here."""
        parts = self._receive(stream, task)
        if self._url is None:
            yield next(parts)  # says that the world has begun, or has failed
            parts = write_world(self._place, task, parts)
        yield from parts

    def _receive(self, stream: Any, task: WorldTask) -> Generator[Any, None, None]:
        """Yield the parts of a world as its task yields them, at last a legend or a failure.

        Before the last one, the worker gets its next world, which it makes while this one's shard
        is completed.
        """
        try:
            for reference in stream:
                part: WorldPart = self._ray.get(reference)
                if isinstance(part, SetupFailure):
                    raise ConfigError(part.reason)
                if isinstance(part, WorldLegend | WorldFailure):
                    break
                yield part
        except self._ray.exceptions.RayError as error:
            part = self._failure(task, error)
        self._rendering -= 1
        self._start_worlds()
        yield part

    def _failure(self, task: WorldTask, error: Exception) -> WorldFailure:
        """Return why a world failed; what concerns all worlds is raised."""
        known = self._ray.exceptions
        if isinstance(error, known.RayTaskError):
            if isinstance(error.cause, OaisysError):
                # The renderer sends what is wrong with a world; this is about writing it.
                raise RenderError(str(error.cause))
            return WorldFailure(task.index, task.split, task.seed, repr(error.cause))
        died = (known.WorkerCrashedError, known.OutOfMemoryError, known.NodeDiedError)
        if not isinstance(error, (*died, known.ObjectLostError)):
            raise error
        reason = f"its worker died: {_first_line(error)}"
        return WorldFailure(task.index, task.split, task.seed, reason, self._retries + 1)


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]
