"""Rolling shutters: each row of depth and labels is seen from the camera's pose at its own time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_worlds import CENTRED, SPHERE, camera, flat_world, rocky_world, settings

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError
from oaisys_core.geometry import pixel_rays, pose_looking_at
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory import Trajectory
from oaisys_core.types import Frame, ModuleMetadata, PinholeIntrinsics, Pose
from oaisys_core.world.modules.lidars import ConstantVelocity

READOUT_S = 0.03
PASSES = ("depth", "semantic_0", "instance", "normal", "range", "rgb")
FISHEYE = PinholeIntrinsics(64, 48, 24.0, 24.0, 31.5, 23.5, (), "equidistant")


def still(intrinsics: PinholeIntrinsics = CENTRED) -> PlacedCamera:
    pose = pose_looking_at((-5.0, 1.0, 3.5), (1.5, 0.5, 0.8))
    return camera(pose, intrinsics, PASSES)


def moving(placed: PlacedCamera) -> PlacedCamera:
    motion = ConstantVelocity(
        placed.T_map_camera, np.array((4.0, -9.0, 2.0)), np.array((1.0, 6.0, -3.0))
    )
    return replace(placed, pose_at=motion, readout_s=READOUT_S)


def rendered(scene: Scene, *cameras: PlacedCamera) -> list[dict[str, Frame]]:
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    found = []
    for each in cameras:
        frames = backend.render_all([each], settings(), lambda _: None)
        found.append({frame.modality: frame for frame in frames})
    return found


@pytest.mark.parametrize("intrinsics", [CENTRED, FISHEYE], ids=["pinhole", "fisheye"])
def test_each_row_is_that_of_a_camera_that_stands_where_it_is_read(
    intrinsics: PinholeIntrinsics,
) -> None:
    scene = replace(rocky_world(), primitives=(SPHERE,))
    rolling = moving(still(intrinsics))
    rows = range(0, 48, 6)
    poses = rolling.row_poses()
    assert poses is not None
    stills = [replace(still(intrinsics), T_map_camera=poses[row]) for row in rows]
    seen, first, *others = rendered(scene, rolling, still(intrinsics), *stills)
    for row, other in zip(rows, others, strict=True):
        for modality in PASSES:
            expected, found = other[modality].data[row], seen[modality].data[row]
            if expected.dtype.kind == "f":
                np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
            else:
                assert np.abs(found.astype(int) - expected.astype(int)).max() <= 1
    np.testing.assert_array_equal(seen["depth"].T_map_camera, first["depth"].T_map_camera)
    assert not np.allclose(seen["depth"].data[-1], first["depth"].data[-1], rtol=1e-2)
    assert (seen["instance"].data > 0).any()


def test_points_of_a_row_are_on_the_surface_from_the_pose_of_the_row() -> None:
    rolling = moving(still())
    (seen,) = rendered(replace(flat_world(), primitives=()), rolling)
    depth_m, poses = seen["depth"].data.astype(float), rolling.row_poses()
    assert poses is not None
    hit = np.isfinite(depth_m)
    points_m = np.where(hit, depth_m, 0.0)[..., None] * pixel_rays(CENTRED)
    in_map_m = np.einsum("hij,hwj->hwi", poses[:, :3, :3], points_m) + poses[:, None, :3, 3]
    assert hit.sum() > 500
    assert np.abs(in_map_m[hit][:, 2] - 0.25).max() < 1e-4


def config(**keys: Any) -> Any:
    sensor = {"width_px": 32, "height_px": 24, "fx_px": 27, "fy_px": 27, "modalities": ["depth"]}
    return config_from_mapping(
        {
            "backend": "analytic",
            "stage": {"preset": "plane", "extent_m": 60.0, "resolution_px": 33},
            "materials": {"texture_size_px": 16, "mask": {"size_px": 16}},
            "assets": {"rocks": []},
            "sensors": {"cameras": [{**sensor, **keys}], "pose_policy": "allow"},
        }
    )


def at(x_m: float, z_m: float) -> ModuleMetadata:
    return ModuleMetadata(sensor={"pose": Pose((x_m, 0.0, z_m), (0.0, 0.6, 0.0, 0.8))})


def test_a_camera_goes_on_as_the_rig_moved_and_its_images_repeat() -> None:
    rolling = config(readout_s=0.05, rate_hz=10.0)
    made = Simulation(rolling)
    made.step_batch(seed=1)
    first = made.step_sample(at(0.0, 5.0)).frames[0].data
    second = made.step_sample(at(0.5, 4.0))
    depth_m = second.frames[0].data
    # From 4 m, it sinks by half a metre while its rows are read; the plane is level.
    heights_m = 4.0 - np.linspace(0.0, 0.5, 24)
    rays = pixel_rays(second.frames[0].intrinsics) @ second.frames[0].T_map_camera[:3, :3].T
    hit = np.isfinite(depth_m)
    expected_m = np.broadcast_to(heights_m[:, None], depth_m.shape) / -rays[..., 2]
    np.testing.assert_allclose(depth_m[hit], expected_m[hit], rtol=1e-5)
    assert hit.sum() > 300
    assert np.isfinite(first).any()
    again = Simulation(rolling).repeat(second.outline)
    assert again.frames[0].data.tobytes() == depth_m.tobytes()


def test_a_global_shutter_sees_all_rows_from_one_pose() -> None:
    made, plain = Simulation(config(exposure_s=0.02)), Simulation(config())
    images: list[NDArray[Any]] = []
    for simulation in (made, plain):
        simulation.step_batch(seed=1)
        simulation.step_sample(at(0.0, 5.0))
        images.append(simulation.step_sample(at(1.0, 4.5)).frames[0].data)
    np.testing.assert_array_equal(images[0], images[1])


def test_poses_of_the_rig_move_the_camera_on_its_mount() -> None:
    made = Simulation(config(readout_s=0.1, mount_position_m=[0.5, 0.0, 0.0]))
    made.step_batch(seed=1)
    start = at(0.0, 5.0).sensor
    assert start is not None
    down = start["pose"].quat_xyzw
    sinking = Trajectory([0.0, 1.0], [(0, 0, 7), (0, 0, -3)], [down, down])
    sample = made.step_sample(at(0.0, 5.0), motion=sinking.motion_about(0.2, 0.0, 0.1))
    frame = sample.frames[0]
    rays = pixel_rays(frame.intrinsics) @ frame.T_map_camera[:3, :3].T
    heights_m = frame.T_map_camera[2, 3] - np.linspace(0.0, 1.0, 24)
    hit = np.isfinite(frame.data)
    expected_m = np.broadcast_to(heights_m[:, None], frame.data.shape) / -rays[..., 2]
    np.testing.assert_allclose(frame.data[hit], expected_m[hit], rtol=1e-5)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"readout_s": 0.01, "shutter_share": 0.5}, "shutter_share must be 0"),
        ({"exposure_s": 0.01, "shutter_share": 0.5}, "shutter_share must be 0"),
        ({"readout_s": 0.01, "distortion": {"k1": 0.1}}, "with distortion"),
        ({"readout_s": 0.01, "modalities": ["flow"]}, "with flow"),
    ],
)
def test_what_goes_not_together_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        config(**keys)
