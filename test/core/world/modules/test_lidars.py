"""Lidars of the rig: when they scan, their motion, their files, their repetition."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.output.reader import read_sample
from oaisys_core.output.writer import SampleWriter
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose, point_dtype
from oaisys_core.world.modules.lidars import ConstantVelocity

CAMERA = {"width_px": 24, "height_px": 18, "modalities": ["depth"]}
SCAN = {"kind": "rotating", "channels": 8, "azimuth_steps": 90, "elevation_min_deg": -45}
YAWED = (0.0, 0.0, 0.6, 0.8)


def config(*lidars: dict[str, Any]) -> Any:
    return config_from_mapping(
        {
            "backend": "analytic",
            "stage": {"preset": "plane", "extent_m": 60.0, "resolution_px": 33},
            "materials": {"texture_size_px": 16, "mask": {"size_px": 16, "relief": 0}},
            "assets": {"rocks": []},
            "sensors": {"cameras": [CAMERA], "lidars": list(lidars)},
        }
    )


def lidar(**keys: Any) -> dict[str, Any]:
    return {"scan": SCAN, "mount_position_m": [0.1, 0.0, 0.2], **keys}


def simulation(*lidars: dict[str, Any], **options: Any) -> Simulation:
    sim = Simulation(config(*lidars), **options)
    sim.step_batch(seed=5)
    return sim


def at(x: float, y: float = 0.0) -> ModuleMetadata:
    return ModuleMetadata(sensor={"pose": Pose((x, y, 4.0), YAWED)})


def test_a_scan_is_part_of_a_sample_at_its_mount() -> None:
    sim = simulation(lidar())
    sample = sim.step_sample(at(1.0))
    scan = sample.scan("lidar")
    mount = np.eye(4)
    mount[:3, 3] = (0.1, 0.0, 0.2)
    np.testing.assert_allclose(scan.T_map_lidar, pose_to_matrix(sample.rig_pose) @ mount)
    assert [(n.sensor, n.modality) for n in sample.outline.frames] == [
        ("camera", "depth"),
        ("lidar", "points"),
    ]
    assert scan.data.dtype == point_dtype()
    assert scan.data.dtype.names == ("x", "y", "z", "intensity", "ring", "time")
    in_map_m = scan.points_m @ scan.T_map_lidar[:3, :3].T + scan.T_map_lidar[:3, 3]
    assert len(scan.data) > 300
    assert np.abs(in_map_m[:, 2]).max() < 1e-3
    assert [info.name for info in sim.info().lidars] == ["lidar"]


def test_lidars_scan_at_their_intervals_or_when_they_are_named() -> None:
    sim = simulation(lidar(name="front", step_interval=2), lidar(name="rear", step_offset=1))
    scans = [[scan.sensor for scan in sim.step_sample().scans] for _ in range(4)]
    assert scans == [["front"], ["rear"], ["front", "rear"], ["rear"]]
    alone = sim.step_sample(sensors=("front",))
    assert ([s.sensor for s in alone.scans], alone.frames) == (["front"], ())
    assert not sim.step_sample(modalities=("depth",)).scans
    assert len(sim.step_sample(modalities=("points",)).scans) == 2
    with pytest.raises(InvalidInputError, match="front"):
        sim.step_sample(sensors=("frnt",))


def test_groups_of_a_sample_begin_with_its_scans() -> None:
    groups = simulation(lidar()).stream_sample(at(0.0))
    outline, first = next(groups)
    assert [scan.sensor for scan in first.scans] == ["lidar"]
    assert len(outline.frames) == 2
    assert [frame.sensor for _, group in groups for frame in group.result()] == ["camera"]


def test_a_cached_view_comes_with_a_new_scan() -> None:
    noisy = lidar(faults={"range_sigma_m": 0.1})
    sim = simulation(noisy, pose_cache_bytes=1 << 20)
    first, second = sim.step_sample(at(0.0)), sim.step_sample(at(0.0))
    assert second.from_cache
    assert first.scans[0].data.tobytes() != second.scans[0].data.tobytes()


def test_faults_are_off_without_configuration_and_when_metadata_turn_them_off() -> None:
    true = simulation(lidar()).step_sample(at(0.0)).scans[0].data
    sim = simulation(lidar(faults={"seed": 4, "range_sigma_m": 0.1, "drop_from_deg": 30.0}))
    noisy = sim.step_sample(at(0.0)).scans[0].data
    off = ModuleMetadata(sensor={"faults": {"enabled": False}})
    assert noisy.tobytes() != true.tobytes()
    assert sim.step_sample(off).scans[0].data.tobytes() == true.tobytes()


def test_a_sweep_goes_on_as_the_rig_moved_and_repeats() -> None:
    sim = simulation(lidar(sweep_share=1.0), lidar(name="still"))
    first, second = sim.step_sample(at(0.0)), sim.step_sample(at(3.0, 1.0))
    shares = second.scan("lidar").data["time"].astype(float) / 0.1
    points = {scan.sensor: scan.points_m for scan in second.scans}
    assert first.scan("lidar").data.tobytes() == first.scan("still").data.tobytes()
    # The plane is level and the motion too: only the azimuths' starting points differ.
    assert len(points["lidar"]) == len(points["still"])
    T = second.scan("lidar").T_map_lidar
    moved = np.column_stack((3 * shares, shares, np.zeros_like(shares)))
    in_map_m = points["lidar"] @ T[:3, :3].T + T[:3, 3] + moved
    assert np.abs(in_map_m[:, 2]).max() < 1e-3
    repeated = simulation(lidar(sweep_share=1.0), lidar(name="still")).repeat(second.outline)
    for scan in second.scans:
        assert repeated.scan(scan.sensor).data.tobytes() == scan.data.tobytes()


def test_constant_velocity_leads_through_both_poses() -> None:
    before = pose_to_matrix(Pose((1.0, 2.0, 3.0), YAWED))
    now = pose_to_matrix(Pose((2.0, 2.0, 5.0), (0.5, 0.5, 0.5, 0.5)))
    motion = ConstantVelocity.between(before, now, 0.4)
    np.testing.assert_allclose(motion(np.array((-0.4, 0.0))), [before, now], atol=1e-12)


def test_files_of_points_are_read_back_and_by_open3d(tmp_path: Path) -> None:
    sim = simulation(lidar(extra_fields=["instance", "label"]))
    sample = sim.step_sample(at(0.0))
    paths = SampleWriter(tmp_path).write(sample)
    batch = tmp_path / "batch_0001"
    path = batch / "lidar" / "0001lidar_points_00.pcd"
    assert path in paths

    read = read_sample(batch, 1)

    assert read.scans[0].data.tobytes() == sample.scans[0].data.tobytes()
    assert read.scans[0].data.dtype == sample.scans[0].data.dtype
    np.testing.assert_array_equal(read.scans[0].T_map_lidar, sample.scans[0].T_map_lidar)
    assert read.outline == sample.outline
    cloud = o3d.t.io.read_point_cloud(str(path))
    np.testing.assert_allclose(cloud.point.positions.numpy(), sample.scans[0].points_m)
    for field in ("intensity", "ring", "time", "label", "instance"):
        found = cloud.point[field].numpy()[:, 0]
        np.testing.assert_array_equal(found, sample.scans[0].data[field])
    poses = (batch / "meta_data" / "sensor_data" / "lidar.csv").read_text().splitlines()
    assert len(poses) == 2


def test_a_file_with_other_fields_is_refused(tmp_path: Path) -> None:
    SampleWriter(tmp_path).write(simulation(lidar()).step_sample(at(0.0)))
    path = tmp_path / "batch_0001" / "lidar" / "0001lidar_points_00.pcd"
    path.write_bytes(path.read_bytes().replace(b"ring", b"echo"))
    with pytest.raises(InvalidInputError, match="PCD"):
        read_sample(tmp_path / "batch_0001", 1)


@pytest.mark.parametrize(
    "lidars",
    [
        [lidar(), lidar()],
        [lidar(name="camera")],
        [lidar(min_range_m=5.0, max_range_m=4.0)],
        [lidar(extra_fields=["label", "label"])],
        [lidar(mount_quat_xyzw=[0.0, 0.0, 0.0, 2.0])],
    ],
)
def test_lidars_that_cannot_be_are_refused(lidars: list[dict[str, Any]]) -> None:
    with pytest.raises(ConfigError):
        config(*lidars)
