"""What a worker of Ray does: it renders one world after the other with one simulation.

Ray runs a task on the main thread of its worker's process, where Blender must be. A process gets
many tasks, so it keeps its simulation.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from typing import NamedTuple

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.errors import BackendUnavailableError, ConfigError
from oaisys_dataset.manifest import WorldFailure, WorldLegend
from oaisys_dataset.places import StoragePlace, open_place
from oaisys_dataset.plan import WorldTask
from oaisys_dataset.rendering.ray_session import worker_name
from oaisys_dataset.rendering.world_render import EncodedView, WorldRenderer
from oaisys_dataset.shards import writing_shard


class SetupFailure(NamedTuple):
    """No world can be rendered, for a reason that is the same on all workers."""

    reason: str


class WorldBegun(NamedTuple):
    """A worker has begun with a world: its process runs."""

    world: int


class ViewCounts(NamedTuple):
    """What is counted of a written view: its frames, and its pixels by label id."""

    world: int
    view: int
    frames: int
    label_pixels: dict[int, int]


WrittenPart = ViewCounts | WorldLegend | WorldFailure
"""What remains of a world's parts when they are written; the last is a legend or a failure."""

WorldPart = WorldBegun | EncodedView | WrittenPart | SetupFailure
"""What a worker sends."""


def render_world(config_json: str, task: WorldTask, url: str | None) -> Iterator[WorldPart]:
    """Render a world, and yield its parts as they are ready.

    Args:
        config_json: The configuration, in canonical form.
        task: The world.
        url: Where the worker writes the shard itself; it then sends counts instead of
            images. None if the driver writes it.
    """
    yield WorldBegun(task.index)
    try:
        renderer = _kept.renderer(config_json)
    except (BackendUnavailableError, ConfigError) as error:
        yield SetupFailure(str(error))
        return
    parts = renderer.render(task)
    yield from parts if url is None else write_world(open_place(url), task, parts)


def write_world(
    place: StoragePlace,
    task: WorldTask,
    parts: Iterable[EncodedView | WorldLegend | WorldFailure],
) -> Generator[WrittenPart, None, None]:
    """Write the parts of a world into its shard, which is kept if a legend comes at last.

    Raises:
        RenderError: The shard could not be written.
    """
    last: WorldFailure | WorldLegend | None = None
    with suppress(_AbandonedShardError), writing_shard(place, task.index) as shard:
        for part in parts:
            if isinstance(part, EncodedView):
                for frame in part.frames:
                    shard.add_encoded(frame)
                for scan in part.scans:
                    shard.add_scan(scan)
                yield _counts_of(task, part)
            elif isinstance(part, WorldLegend):
                shard.finish(part)
                last = part
                break
            else:
                last = part
                raise _AbandonedShardError
    if last is not None:
        yield last


def _counts_of(task: WorldTask, part: EncodedView) -> ViewCounts:
    pixels: Counter[int] = Counter()
    for frame in part.frames:
        pixels.update(frame.record.label_pixels)
    return ViewCounts(task.index, part.view, len(part.frames), dict(pixels))


class _AbandonedShardError(Exception):
    """The world has failed, so its shard is not kept."""


class _KeptRenderer:
    """The renderer of this process, made when it is first needed."""

    def __init__(self) -> None:
        self._config_json = ""
        self._renderer: WorldRenderer | None = None

    def renderer(self, config_json: str) -> WorldRenderer:
        """Return the renderer of a configuration, and close that of another one."""
        if self._renderer is None or self._config_json != config_json:
            if self._renderer is not None:
                self._renderer.close()
            self._renderer = None
            config: SimulationConfig = config_from_mapping(json.loads(config_json))
            self._renderer = WorldRenderer(config, worker_name())
            self._config_json = config_json
        return self._renderer


_kept = _KeptRenderer()
