"""Renders a data set: begins or continues it, has its worlds rendered, and sums up."""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from itertools import zip_longest
from typing import Any

from oaisys_core.config import SimulationConfig, canonical_json, config_sha256
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.files.folders import own_folder
from oaisys_core.world.config_files import name_faults
from oaisys_dataset.card.statistics import class_shares
from oaisys_dataset.manifest import DatasetInfo, WorldFailure
from oaisys_dataset.places import StoragePlace
from oaisys_dataset.plan import WorldTask, world_tasks
from oaisys_dataset.reader import open_dataset
from oaisys_dataset.rendering.engine import DatasetEvent, WorldFinished, render_worlds
from oaisys_dataset.rendering.ray_settings import RaySettings
from oaisys_dataset.rendering.workers import ViewCounts
from oaisys_dataset.shards import HEAD, read_head, whole_worlds

PACKAGES = ("oaisys_core", "bpy", "numpy", "open3d")

_log = logging.getLogger(__name__)


@dataclass
class DatasetSummary:
    """What a command has rendered, and what the whole data set shows.

    Attributes:
        planned: Number of worlds that the data set is to have.
        kept: Number of worlds that earlier commands finished.
        finished: Number of worlds that this command has finished.
        frames: Number of frames that it has rendered, also of worlds that are not finished.
        failures: The worlds that it could not make.
        in_work: The views so far of worlds that are being rendered, by world.
        label_pixels: Pixels of all finished worlds by label id.
        labels: Label by id.
    """

    planned: int = 0
    kept: int = 0
    finished: int = 0
    frames: int = 0
    failures: list[WorldFailure] = field(default_factory=list)
    in_work: dict[int, list[ViewCounts]] = field(default_factory=dict)
    label_pixels: Counter[int] = field(default_factory=Counter)
    labels: dict[int, str] = field(default_factory=dict)

    def count(self, event: DatasetEvent) -> None:
        """Count what happened."""
        if isinstance(event, ViewCounts):
            self.frames += event.frames
            self.in_work.setdefault(event.world, []).append(event)
        elif isinstance(event, WorldFinished):
            self.finished += 1
            self.labels.update(event.labels)
            for view in self.in_work.pop(event.world, ()):
                self.label_pixels.update(view.label_pixels)
        elif isinstance(event, WorldFailure):
            self.in_work.pop(event.world, None)
            self.failures.append(event)

    def views_done(self, views_per_world: int) -> int:
        """Return the number of views that are rendered; all of a world that failed count."""
        worlds = self.kept + self.finished + len(self.failures)
        return worlds * views_per_world + sum(map(len, self.in_work.values()))

    def class_shares(self) -> dict[str, float]:
        """Return the share of the pixels by label, the largest first."""
        return class_shares(self.label_pixels, self.labels)


class DatasetRendering:
    """A data set that is being rendered into a place.

    Attributes:
        info: What the data set is.
        summary: What has been rendered so far.
        left: The worlds that are missing.
    """

    def __init__(self, place: StoragePlace, config: SimulationConfig, info: DatasetInfo) -> None:
        """Prepare for a data set that is empty so far, or that an earlier command began.

        Raises:
            ConfigError: The configuration names something that does not exist.
        """
        faults = name_faults(config)
        if faults:
            raise ConfigError("\n".join(faults))
        self.info = info
        self.summary = DatasetSummary(planned=info.worlds)
        self.left: Sequence[WorldTask] = ()
        self._place = place
        self._config = config

    @contextmanager
    def begin(self, *, is_resumed: bool) -> Iterator[None]:
        """Own the place during a block, and write the head of the data set.

        Raises:
            InvalidInputError: There is a data set already, or with ``is_resumed`` another one.
            NotReadyError: Another command is writing to it.
        """
        folder = self._place.folder
        with nullcontext() if folder is None else own_folder(folder):
            self._place.delete_parts()
            earlier = _head(self._place)
            if earlier is not None and not is_resumed:
                expected = "a place without a data set, or --resume to continue that one"
                raise InvalidInputError("out", self._place.url, expected)
            if earlier is not None:
                check_same(earlier, self.info)
            if earlier is None or earlier.worlds != self.info.worlds:
                self._place.write(HEAD, self.info.to_json().encode())
            self._plan()
            yield

    def run(self, settings: RaySettings) -> Iterator[DatasetEvent]:
        """Render the missing worlds, and yield what happens; worlds that failed are tried again.

        Raises:
            OaisysError: See `render_worlds`.
        """
        if not self.left:
            return
        for event in render_worlds(self._place, self._config, self.left, settings):
            self.summary.count(event)
            yield event

    def _plan(self) -> None:
        info = self.info
        finished = set(whole_worlds(self._place))
        tasks = world_tasks(info.seed, info.worlds, info.views, info.splits)
        self.left = [task for task in tasks if task.index not in finished]
        self.summary.kept = self._count_kept() if finished else 0

    def _count_kept(self) -> int:
        """Count the pixels of the finished worlds, and return the number of these worlds."""
        dataset, summary = open_dataset(self._place.url), self.summary
        for record in dataset.records:
            summary.label_pixels.update(record.label_pixels)
            if record.label_pixels.keys() - summary.labels.keys() - {0}:
                summary.labels.update(dataset.legend(record.world).labels)
        return len(dataset.worlds)


def dataset_info(
    config: SimulationConfig, worlds: int, views: int, splits: Mapping[str, float]
) -> DatasetInfo:
    """Return the head of a data set."""
    return DatasetInfo(
        config=json.loads(canonical_json(config)),
        config_sha256=config_sha256(config),
        seed=config.seed,
        worlds=worlds,
        views=views,
        splits=dict(splits),
        software={name: found for name in PACKAGES if (found := _version(name))},
    )


def check_same(earlier: DatasetInfo, now: DatasetInfo) -> None:
    """Raise unless a data set can be continued as another head says.

    Raises:
        InvalidInputError: They differ in more than software, or some worlds would be too many.
    """
    if earlier.merged:
        expected = "a data set that was not merged: continue those that it was merged from"
        raise InvalidInputError("resume", f"{len(earlier.merged)} merged sets", expected)
    path, before, wanted = first_difference(earlier.config, now.config) or ("", None, None)
    if path:
        raise InvalidInputError(path, wanted, f"{before!r}, as the data set was begun")
    for name in ("config_sha256", "seed", "views", "splits"):
        before, wanted = getattr(earlier, name), getattr(now, name)
        if before != wanted:
            raise InvalidInputError(name, wanted, f"{before!r}, as the data set was begun")
    if now.worlds < earlier.worlds:
        expected = f"at least {earlier.worlds}, as the data set was begun"
        raise InvalidInputError("worlds", now.worlds, expected)
    if earlier.software != now.software:
        text = "the data set was begun with %s, and continues with %s: images may differ"
        _log.warning(text, dict(earlier.software), dict(now.software))


def first_difference(before: Any, now: Any, path: str = "") -> tuple[str, Any, Any] | None:
    """Return the path of the first value that differs in JSON data, and both values, or None.

    A key or item that is missing in one of them has the value None there.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        keys = [*before, *(key for key in now if key not in before)]
        pairs = [(str(key), before.get(key), now.get(key)) for key in keys]
    elif isinstance(before, list) and isinstance(now, list):
        both = zip_longest(before, now)
        pairs = [(str(index), *values) for index, values in enumerate(both)]
    else:
        return None if before == now else (path, before, now)
    found = (first_difference(a, b, f"{path}.{key}".lstrip(".")) for key, a, b in pairs)
    return next((each for each in found if each is not None), None)


def _head(place: StoragePlace) -> DatasetInfo | None:
    return read_head(place) if place.exists(HEAD) else None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
