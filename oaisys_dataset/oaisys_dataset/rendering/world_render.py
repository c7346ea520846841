"""Renders the worlds of a data set, view by view, in this process."""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from math import degrees
from typing import Any, NamedTuple

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import OaisysError, RenderError
from oaisys_core.output.records import intrinsics_record
from oaisys_core.raycast.objects.views import ObjectFinder
from oaisys_core.scene import Scene
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    INSTANCE,
    FloatArray,
    Frame,
    LidarScan,
    ObjectQuery,
    Sample,
    SceneObject,
)
from oaisys_core.world.batch import DRAWN
from oaisys_dataset.manifest import FrameRecord, LegendInstance, WorldFailure, WorldLegend
from oaisys_dataset.plan import WorldTask
from oaisys_dataset.records import frame_id
from oaisys_dataset.scans import EncodedScan, ScanRecord, encode_scan_points
from oaisys_dataset.shards import EncodedFrame, encode_frame

S_PER_VIEW = 1.0
"""Simulated time from one view to the next, unless the sun has its own."""

OBJECTS_AT_ONCE = 5000
"""Objects that are listed at once."""


class EncodedView(NamedTuple):
    """A finished view: its number, and what all cameras and lidars measured that were due."""

    view: int
    frames: tuple[EncodedFrame, ...]
    scans: tuple[EncodedScan, ...] = ()


@dataclass(frozen=True)
class _View:
    """A view that is rendered, and not encoded yet.

    Attributes:
        number: Its number.
        sample: What was rendered.
        seconds: What all of it took.
        scene: The world at that time.
        sun_deg: Elevation and azimuth of the sun.
        s_per_view: Simulated time from one view to the next.
        drawn: What was drawn of the configuration for its world.
    """

    number: int
    sample: Sample
    seconds: float
    scene: Scene
    sun_deg: tuple[float, float]
    s_per_view: float
    drawn: Mapping[str, Any]


class WorldRenderer:
    """Renders worlds with one simulation, one after the other.

    Each world starts from its seed alone; nothing of the worlds before it remains.
    """

    def __init__(self, config: SimulationConfig, worker: str) -> None:
        """Set the simulation up.

        Args:
            config: What worlds are drawn from.
            worker: Name of this process in the records of frames.

        Raises:
            ConfigError: The configuration names something that does not exist.
            BackendUnavailableError: The backend cannot run here.
        """
        self._simulation = Simulation(config)
        self._finder = ObjectFinder()
        self._worker = worker
        self._software = software(self._simulation)

    def render(self, task: WorldTask) -> Iterator[EncodedView | WorldLegend | WorldFailure]:
        """Yield the views of a world and at last its legend, or the reason why it cannot be made.

        The images of a view are encoded while the next view is rendered.
        """
        doing = "making the world"
        try:
            with ThreadPoolExecutor(1, "encoder") as encoder:
                encoding: Future[EncodedView] | None = None
                begun_s, frames = time.perf_counter(), 0
                self._begin(task)
                for number in range(task.views):
                    doing = f"view {number}"
                    sample = self._simulation.step_sample()
                    now_s = time.perf_counter()
                    scene, seconds = self._simulation.scene, now_s - begun_s
                    of_world = self._of_world()
                    view = _View(number, sample, seconds, scene, _sun_deg(scene), *of_world)
                    frames += len(sample.frames)
                    begun_s = now_s
                    if encoding is not None:
                        yield encoding.result()
                    encoding = encoder.submit(self._encode, task, view)
                if encoding is not None:
                    yield encoding.result()
            doing = f"{task.views} views"
            if not frames:
                # Also of a variant whose render settings leave out all images.
                raise RenderError("no camera was due, see step_offset, quality and passes")
            yield self._legend()
        except OaisysError as error:
            yield WorldFailure(task.index, task.split, task.seed, f"{doing}: {error}")

    def close(self) -> None:
        """Release the simulation."""
        self._simulation.close()

    def _begin(self, task: WorldTask) -> None:
        self._simulation.restore({"last_batch_id": task.index, "batch": None})
        self._simulation.step_batch(seed=task.seed)

    def _encode(self, task: WorldTask, view: _View) -> EncodedView:
        by_sensor: dict[str, list[Frame]] = {}
        for frame in view.sample.frames:
            by_sensor.setdefault(frame.sensor, []).append(frame)
        scans = view.sample.scans
        shared = self._common_fields(task, view, max(1, len(by_sensor) + len(scans)))
        return EncodedView(
            view.number,
            tuple(self._encode_frame(frames, shared, view) for frames in by_sensor.values()),
            tuple(_encode_scan(scan, shared) for scan in scans),
        )

    def _common_fields(self, task: WorldTask, view: _View, records: int) -> dict[str, Any]:
        """Return the fields that are equal in the records of a view's frames and scans."""
        sample = view.sample
        return {
            "world": task.index,
            "view": view.number,
            "split": task.split,
            "world_seed": task.seed,
            "config_sha256": sample.provenance.config_sha256,
            "stamp_s": view.number * view.s_per_view,
            "provenance": asdict(sample.provenance),
            "rig_pose": asdict(sample.rig_pose),
            "worker": self._worker,
            "seconds": round(view.seconds / records, 3),
            "software": self._software,
        }

    def _of_world(self) -> tuple[float, Mapping[str, Any]]:
        """Return what all views of the current world have in common."""
        return seconds_per_view(self._simulation.world_config), self._simulation.draws

    def _encode_frame(
        self, frames: Sequence[Frame], shared: Mapping[str, Any], view: _View
    ) -> EncodedFrame:
        """Return the frame of a camera from its images at a view."""
        encoded = _encode_frame(frames, shared, view)
        ids = next((frame.data for frame in frames if frame.modality == INSTANCE), None)
        if ids is None:
            return encoded
        from oaisys_dataset.objects import frame_objects

        record = encoded.record
        found = self._finder.find(view.scene, record.camera, record.pose, ids)
        return encoded._replace(objects=frame_objects(record, found))

    def _legend(self) -> WorldLegend:
        """Return the legend of the current world, with all its objects."""
        instances = {
            each.instance_id: LegendInstance(
                each.name, each.label, each.semantic_id, each.kind, each.group
            )
            for each in all_objects(self._simulation)
        }
        return WorldLegend(dict(self._simulation.info().semantic_labels), instances)


def all_objects(simulation: Simulation) -> Iterator[SceneObject]:
    """Yield all objects of a simulation's current world."""
    after: int | None = 0
    while after is not None:
        page = simulation.list_objects(ObjectQuery(after_instance_id=after, limit=OBJECTS_AT_ONCE))
        yield from page.objects
        after = page.next_after_instance_id or None


def _sun_deg(scene: Scene) -> tuple[float, float]:
    """Return the elevation and azimuth of the sun."""
    sky = scene.sky
    return round(degrees(sky.sun_elevation_rad), 6), round(degrees(sky.sun_azimuth_rad), 6)


def _encode_frame(frames: Sequence[Frame], shared: Mapping[str, Any], view: _View) -> EncodedFrame:
    """Return the frame of a camera from its images at a view."""
    first = frames[0]
    record = FrameRecord(
        frame_id=frame_id(shared["world"], shared["view"], first.sensor),
        sensor=first.sensor,
        metadata={DRAWN: dict(view.drawn)} if view.drawn else {},
        T_map_camera=_rows(first.T_map_camera),
        intrinsics=intrinsics_record(first.intrinsics),
        images={},
        sun_elevation_deg=view.sun_deg[0],
        sun_azimuth_deg=view.sun_deg[1],
        **shared,
    )
    return encode_frame(record, {frame.modality: frame.data for frame in frames})


def _encode_scan(scan: LidarScan, shared: Mapping[str, Any]) -> EncodedScan:
    scan_id = frame_id(shared["world"], shared["view"], scan.sensor)
    points, file = encode_scan_points(scan_id, scan)
    record = ScanRecord(
        scan_id=scan_id,
        sensor=scan.sensor,
        T_map_lidar=_rows(scan.T_map_lidar),
        points=points,
        **shared,
    )
    return EncodedScan(record, file)


def _rows(T: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in T.tolist())


def software(simulation: Simulation) -> dict[str, str]:
    """Return the versions of what renders, by name."""
    info = simulation.info()
    return {**_versions(), info.backend: info.backend_version}


@cache
def _versions() -> dict[str, str]:
    packages = ("oaisys_core", "numpy", "open3d")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


def seconds_per_view(config: SimulationConfig) -> float:
    """Return the simulated time from one view to the next."""
    sun: Any = config.environment.sun_from_time
    return float(sun.s_per_sample) if sun is not None and sun.s_per_sample > 0 else S_PER_VIEW
