"""The queue of worlds, with a Ray that renders nothing."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from synthetic_datasets import LEGEND, drawn_arrays, frame_record

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import OaisysError, RenderError
from oaisys_core.randomness import stream
from oaisys_dataset.manifest import WorldFailure
from oaisys_dataset.places import LocalPlace
from oaisys_dataset.plan import WorldTask, world_tasks
from oaisys_dataset.rendering import engine
from oaisys_dataset.rendering.engine import Waiting, WorldFinished, render_worlds
from oaisys_dataset.rendering.ray_session import RaySession
from oaisys_dataset.rendering.ray_settings import RaySettings
from oaisys_dataset.rendering.workers import WorldBegun, WorldPart
from oaisys_dataset.rendering.world_render import EncodedView
from oaisys_dataset.shards import encode_frame, whole_worlds

TASKS = list(world_tasks(3, 3, 1, {"all": 1.0}))


class PretendedRay:
    """Gives out the parts of worlds in order.

    Attributes:
        begun: The worlds that were begun.
    """

    exceptions = SimpleNamespace(RayError=ZeroDivisionError)

    def __init__(self, failing: int | None = None) -> None:
        self._failing = failing
        self.begun: list[int] = []

    def put(self, value: Any) -> Any:
        return value

    get = put

    def options(self, **_: Any) -> PretendedRay:
        return self

    def remote(self, *arguments: Any, **options: Any) -> Any:
        """Return itself for options and a function, and the parts of a world for a call."""
        if options:
            return self.remote
        if len(arguments) == 1:
            return self
        task: WorldTask = arguments[1]
        self.begun.append(task.index)
        return iter(self._parts(task))

    def wait(self, streams: list[Any], **_: Any) -> tuple[list[Any], list[Any]]:
        return streams[:1], streams[1:]

    def _parts(self, task: WorldTask) -> Iterator[WorldPart]:
        frame = frame_record(task.index, 0, task.split)
        yield WorldBegun(task.index)
        yield EncodedView(0, (encode_frame(frame, drawn_arrays(stream(task.seed, "test"))),))
        if task.index == self._failing:
            yield WorldFailure(task.index, task.split, task.seed, "no view")
        else:
            yield LEGEND


class WatchedPlace(LocalPlace):
    """Calls a function before the file of a shard gets its name."""

    def __init__(self, folder: Path, watch: Callable[[str], object]) -> None:
        super().__init__(folder)
        self._watch = watch

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        with super().writing(name) as path:
            yield path
            self._watch(name)


def events(
    ray: PretendedRay,
    place: LocalPlace,
    monkeypatch: pytest.MonkeyPatch,
    ray_folder: Path | None = None,
) -> Generator[Any, None, None]:
    """Render `TASKS` with one worker."""

    @contextmanager
    def session(settings: RaySettings) -> Iterator[RaySession]:
        yield RaySession(ray, settings.workers or 0, ray_folder)

    monkeypatch.setattr(engine, "ray_session", session)
    yield from render_worlds(place, SimulationConfig(), TASKS, RaySettings(workers=1))


def test_a_worker_has_its_next_world_while_the_shard_of_the_last_one_is_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = PretendedRay()
    begun: dict[str, int] = {}
    place = WatchedPlace(tmp_path, lambda name: begun.setdefault(name, len(ray.begun)))
    found = [e.world for e in events(ray, place, monkeypatch) if isinstance(e, WorldFinished)]
    assert found == [0, 1, 2]
    assert begun["shards/world_000000.tar"] == 2  # never more than one world ahead
    assert begun["shards/world_000001.tar"] == begun["shards/world_000002.tar"] == 3


def test_a_world_that_fails_is_followed_by_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = LocalPlace(tmp_path)
    found = list(events(PretendedRay(failing=1), place, monkeypatch))
    assert [e.world for e in found if isinstance(e, WorldFailure)] == [1]
    assert whole_worlds(place) == [0, 2]


def test_a_shard_that_cannot_be_completed_ends_the_run_and_leaves_nothing_half_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(name: str) -> None:
        if "000001" in name:
            raise OSError(28, "No space left on device")

    place = WatchedPlace(tmp_path, full)
    with pytest.raises(RenderError, match=r"world_000001.tar: could not be written: No space"):
        list(events(PretendedRay(), place, monkeypatch))
    assert whole_worlds(place) == [0]
    assert not list(tmp_path.rglob("*.part"))


class IdleRay(PretendedRay):
    """None of its workers ever begins."""

    def wait(self, streams: list[Any], **_: Any) -> tuple[list[Any], list[Any]]:
        return [], streams


def test_workers_that_never_begin_end_the_run_and_ray_s_logs_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(engine, "WORKER_START_S", -1.0)
    logs = tmp_path / "ray" / "session_latest" / "logs"
    logs.mkdir(parents=True)
    (logs / "raylet.out").write_text("[a C 1 1] (raylet) Check failed: a.ok() Timed out\n")
    place = LocalPlace(tmp_path / "set")
    expected = r"Ray has begun .* \(a.ok\(\) Timed out in the logs (.*); load .* on \d+ cores\)"
    with pytest.raises(OaisysError, match=expected) as raised:
        list(events(IdleRay(), place, monkeypatch, tmp_path / "ray"))
    kept = re.search(expected, str(raised.value))
    assert kept is not None
    assert Path(kept[1], "raylet.out").is_file()
    others = events(IdleRay(), place, monkeypatch)  # a cluster, whose cores others use
    assert isinstance(next(others), Waiting)
    others.close()
