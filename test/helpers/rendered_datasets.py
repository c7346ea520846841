"""A small data set of real worlds, rendered by the analytic backend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core import randomness
from oaisys_core.config import SimulationConfig, config_from_mapping, config_sha256
from oaisys_core.geometry import pose_looking_at
from oaisys_core.output.records import intrinsics_record
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, ModuleMetadata, ObjectQuery, Pose, Sample
from oaisys_dataset.manifest import DatasetInfo, FrameRecord, LegendInstance, WorldLegend
from oaisys_dataset.places import open_place
from oaisys_dataset.records import frame_id
from oaisys_dataset.shards import HEAD, writing_shard

WORLDS = {0: "train", 1: "train", 2: "val"}
"""Split by world."""

VIEWS = 2
EXTENT_M = 20.0
MODALITIES = ["rgb", "depth", "semantic_0", "instance", "normal"]


def small_config(sensors: Mapping[str, Any] | None = None) -> SimulationConfig:
    """Return a world with rocks, seen by one camera that sees some sky, or by other sensors."""
    camera = {"width_px": 64, "height_px": 48, "modalities": MODALITIES}
    return config_from_mapping(
        {
            "seed": 11,
            "backend": "analytic",
            "stage": {"preset": "plane", "extent_m": EXTENT_M, "resolution_px": 65},
            "materials": {"texture_size_px": 64, "mask": {"size_px": 32, "relief": 0}},
            "sensors": sensors or {"cameras": [camera]},
            "assets": {"rocks": [{"count": [80, 80]}]},
            "environment": {"sun_elevation_deg": [10, 80], "ground_beyond": False},
        }
    )


def rig_sensors() -> dict[str, Any]:
    """Return a stereo pair without, and two cameras with distortion; ``wide`` skips views."""
    size = {"width_px": 64, "height_px": 48, "modalities": MODALITIES}
    lens = {"k1": -0.2, "k2": 0.05, "p1": 0.002, "p2": -0.001}
    skewed = {**size, "fx_px": 50.0, "fy_px": 47.0, "cx_px": 30.5, "cy_px": 25.0}
    turned = {"mount_position_m": [0.1, 0.2, 0.3], "mount_quat_xyzw": [0.0, 0.0, 0.28, 0.96]}
    wide = {**skewed, "name": "wide", "distortion": {**lens, "k3": -0.004}, "step_interval": 2}
    return {
        "stereo": [{**size, "baseline_m": 0.25}],
        "cameras": [wide, {**skewed, **turned, "name": "turned", "distortion": lens}],
    }


def write_rendered_dataset(
    where: str | Path,
    worlds: Mapping[int, str] = WORLDS,
    views: int = VIEWS,
    sensors: Mapping[str, Any] | None = None,
) -> None:
    """Render worlds and write them as a data set.

    Args:
        where: Its place.
        worlds: The split of each world.
        views: Number of views of each world, around its middle.
        sensors: Section of the configuration; None for one camera.
    """
    config = small_config(sensors)
    info = DatasetInfo(
        config=config.model_dump(mode="json"),
        config_sha256=config_sha256(config),
        seed=config.seed,
        worlds=max(worlds) + 1,
        views=views,
        splits={"train": 0.7, "val": 0.3},
    )
    place = open_place(where)
    place.write(HEAD, info.to_json().encode())
    simulation = Simulation(config)
    for world, split in worlds.items():
        simulation.step_batch(seed=randomness.batch_seed(config.seed, world + 1))
        with writing_shard(place, world) as shard:
            for view in range(views):
                sample = simulation.step_sample(ModuleMetadata(sensor={"pose": _pose(view)}))
                for frames in _by_sensor(sample):
                    record = _record(simulation, sample, frames[0], world, view, split)
                    shard.add(record, {frame.modality: frame.data for frame in frames})
            shard.finish(_legend(simulation))
    simulation.close()


def _pose(view: int) -> Pose:
    angle = np.pi / 3 * view
    eye_m = 9 * np.cos(angle), 9 * np.sin(angle), 2.5
    return pose_looking_at(eye_m, (0.0, 0.0, 1.0))


def _by_sensor(sample: Sample) -> list[list[Frame]]:
    by_sensor: dict[str, list[Frame]] = {}
    for frame in sample.frames:
        by_sensor.setdefault(frame.sensor, []).append(frame)
    return list(by_sensor.values())


def _record(
    simulation: Simulation, sample: Sample, frame: Frame, world: int, view: int, split: str
) -> FrameRecord:
    sky = simulation.scene.sky
    return FrameRecord(
        frame_id=frame_id(world, view, frame.sensor),
        world=world,
        view=view,
        sensor=frame.sensor,
        split=split,
        world_seed=sample.provenance.batch_seed,
        config_sha256=sample.provenance.config_sha256,
        metadata={},
        T_map_camera=tuple(tuple(row) for row in frame.T_map_camera.tolist()),
        intrinsics=intrinsics_record(frame.intrinsics),
        stamp_s=view / 30,
        images={},
        provenance=asdict(sample.provenance),
        rig_pose=asdict(sample.rig_pose),
        worker=f"host:{world % 2}",
        seconds=0.5,
        software={"oaisys": "0.1.0"},
        sun_elevation_deg=degrees(sky.sun_elevation_rad),
        sun_azimuth_deg=degrees(sky.sun_azimuth_rad),
    )


def _legend(simulation: Simulation) -> WorldLegend:
    things = {
        thing.instance_id: LegendInstance(
            thing.name, thing.label, thing.semantic_id, thing.kind, thing.group
        )
        for thing in simulation.list_objects(ObjectQuery()).objects
    }
    return WorldLegend(simulation.info().semantic_labels, things)
