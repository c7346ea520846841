"""Worlds of a data set, rendered in this process."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from dataset_runs import CONFIG
from repository import HELPERS
from worker_memory import WORLDS

from oaisys_core.config import canonical_json, config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_dataset.manifest import WorldFailure, WorldLegend
from oaisys_dataset.places import open_place
from oaisys_dataset.plan import world_tasks
from oaisys_dataset.reader import open_dataset
from oaisys_dataset.rendering.dataset_rendering import dataset_info
from oaisys_dataset.rendering.workers import (
    SetupFailure,
    ViewCounts,
    WorldBegun,
    render_world,
    write_world,
)
from oaisys_dataset.rendering.world_render import EncodedView, WorldRenderer
from oaisys_dataset.shards import HEAD, tar_name, whole_worlds

MAX_KEPT_SHARE = 0.1
"""Memory that a worker may gain with each world, as a share of the images of one of its views."""

TASKS = list(world_tasks(3, 3, 2, {"train": 0.5, "val": 0.5}))


@pytest.fixture(scope="module")
def config():
    return config_from_mapping(yaml.safe_load(CONFIG))


def rendered(config, tasks):
    """The files of some worlds' frames, rendered one after the other."""
    renderer = WorldRenderer(config, "test")
    try:
        return {
            frame.record.frame_id: (
                replace(frame.record, seconds=0.0, worker="").to_json(),
                dict(frame.files),
            )
            for task in tasks
            for part in renderer.render(task)
            if isinstance(part, EncodedView)
            for frame in part.frames
        }
    finally:
        renderer.close()


def test_a_world_is_the_same_whatever_was_rendered_before_it(config):
    in_order = rendered(config, TASKS)
    assert len(in_order) == 6
    assert rendered(config, [TASKS[2], TASKS[0], TASKS[0], TASKS[1]]) == in_order
    assert rendered(config, TASKS[1:2]).items() <= in_order.items()


@pytest.mark.parametrize("lidars", [[], [{"name": "lid", "scan": {"channels": 8}}]])
def test_a_world_without_any_image_fails(lidars):
    data = yaml.safe_load(CONFIG)
    data["sensors"]["cameras"][0]["step_offset"] = 9
    data["sensors"]["lidars"] = lidars
    renderer = WorldRenderer(config_from_mapping(data), "test")
    *_, failure = renderer.render(TASKS[0])
    renderer.close()
    assert isinstance(failure, WorldFailure)
    assert "no camera was due" in failure.reason


def test_a_world_of_a_data_set_is_a_batch_of_the_simulation(config, tmp_path: Path):
    place = open_place(tmp_path)
    place.write(HEAD, dataset_info(config, 3, 2, {"train": 0.5, "val": 0.5}).to_json().encode())
    renderer = WorldRenderer(config, "test")
    parts = list(write_world(place, TASKS[1], renderer.render(TASKS[1])))
    renderer.close()
    assert isinstance(parts[-1], WorldLegend)
    simulation = Simulation(config)
    simulation.step_batch()
    simulation.step_batch()
    dataset = open_dataset(tmp_path)
    assert len(dataset) == 2
    for sample in dataset:
        expected = simulation.step_sample()
        for modality, pixels in sample.arrays.items():
            frame = expected.frame("camera", modality)
            assert pixels.tobytes() == np.ascontiguousarray(frame.data).tobytes()
        np.testing.assert_array_equal(sample.T_map_camera, frame.T_map_camera)
        np.testing.assert_array_equal(sample.K, frame.intrinsics.K)
        ids = set(np.unique(sample.arrays["instance"])) - {0}
        assert ids <= dataset.legend(1).instances.keys()
        assert set(np.unique(sample.arrays["semantic_0"])) <= dataset.legend(1).labels.keys()
        ids, counts = np.unique(sample.arrays["semantic_0"], return_counts=True)
        assert sample.record.label_pixels == dict(zip(ids.tolist(), counts.tolist(), strict=True))
    simulation.close()


def test_a_world_without_enough_poses_fails_with_its_reason_and_leaves_no_shard(tmp_path: Path):
    poses = tmp_path / "poses.csv"
    poses.write_text("x_m,y_m,z_m,qx,qy,qz,qw\n0,0,9,0,0.7071068,0,0.7071068\n")
    data = yaml.safe_load(CONFIG)
    data["sensors"]["motion"] = {"kind": "csv", "path": str(poses), "at_end": "refuse"}
    renderer = WorldRenderer(config_from_mapping(data), "test")
    place = open_place(tmp_path / "set")
    parts = list(write_world(place, TASKS[0], renderer.render(TASKS[0])))
    renderer.close()
    failure = parts[-1]
    assert isinstance(failure, WorldFailure)
    assert failure.reason.startswith("view 1: sensors.motion")
    assert whole_worlds(place) == []
    assert not [path for path in tmp_path.rglob("*") if ".part" in path.name]


def test_a_worker_writes_the_shard_itself_where_all_machines_can(config, tmp_path: Path):
    url = f"memory://{tmp_path.name}"
    parts = list(render_world(canonical_json(config), TASKS[2], url))
    assert [type(part) for part in parts] == [WorldBegun, ViewCounts, ViewCounts, WorldLegend]
    assert [part.frames for part in parts if isinstance(part, ViewCounts)] == [1, 1]
    place = open_place(url)
    assert whole_worlds(place) == [2]
    renderer = WorldRenderer(config, "test")
    here = open_place(tmp_path)
    list(write_world(here, TASKS[2], renderer.render(TASKS[2])))
    renderer.close()
    assert place.read(tar_name(2)) == here.read(tar_name(2))


def test_what_no_worker_can_render_is_said_once(config):
    broken = canonical_json(config).replace('"mounds"', '"moundz"')
    begun, part = render_world(broken, TASKS[0], None)
    assert isinstance(begun, WorldBegun)
    assert isinstance(part, SetupFailure)
    assert "moundz" in part.reason


@pytest.mark.soak
def test_a_worker_keeps_nothing_of_the_worlds_that_it_has_rendered(tmp_path: Path):
    place = open_place(tmp_path)
    place.write(
        HEAD, dataset_info(config_from_mapping(WORLDS), 26, 2, {"train": 1}).to_json().encode()
    )
    ended = subprocess.run(
        [sys.executable, str(HELPERS / "worker_memory.py"), str(tmp_path), "26"],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
        # Of its allocator's arenas, only the first one is trimmed whole.
        env={**os.environ, "MALLOC_ARENA_MAX": "1"},
    )
    held_mb = json.loads(ended.stdout.splitlines()[-1])
    images_mb = sum(pixels.nbytes for pixels in open_dataset(tmp_path)[0].arrays.values()) / 1e6
    early, late = slice(5, 8), slice(23, 26)
    mb_per_world = (np.median(held_mb[late]) - np.median(held_mb[early])) / 18
    assert mb_per_world < MAX_KEPT_SHARE * images_mb, held_mb
