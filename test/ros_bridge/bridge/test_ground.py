"""The true ground over ROS: heights, mesh, and maps read by their definitions alone."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point
from grid_map_msgs.msg import GridMap
from grid_readers import read_layer, read_occupancy
from nav_msgs.msg import OccupancyGrid
from ros_peer import Stage, User, nanoseconds
from served_simulator import FLAT_WORLD, Server
from std_msgs.msg import Header
from vision_msgs.msg import Detection3DArray

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_mapping.evaluation.truth_io import read_truth
from oaisys_msgs.srv import FromLonLat, GetGroundTruthMesh, QueryHeight, ToLonLat
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros

STONE_ID = 20
WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 40, "resolution_px": 129},
    "assets": {
        "rocks": [],
        "primitives": [
            {
                "shape": "sphere",
                "radius_m": 1.0,
                "position_m": [3.0, -2.0, 3.0],
                "label": "stone",
                "semantic_id": STONE_ID,
            }
        ],
    },
}
LENGTH_M, CELL_M = 12.0, 0.25
BOXES = "camera/detections_3d"
PARAMETERS = (f"ground_map.length_m:={LENGTH_M}", f"ground_map.resolution_m:={CELL_M}")
HASHES = {
    "msg/GridMap": "343b0e72887541beda6b035cc053f2d6fffaad9d6dcb2773c15a808dfca31fde",
    "msg/GridMapInfo": "0a36d6b5bc9af8463d1d5a5008ef9fcac0c1373ba090f80c3594e47cc565b745",
    "srv/GetGridMap": "3ff0927db3d7a2ccf9d619e2332e7a5e0114c336219cd991230beb09bd661273",
    "srv/GetGridMapInfo": "fc6dea3589dd11355399dd457473495665118eaf78d6124905b42b309480c423",
    "srv/ProcessFile": "58adbbe82a3148c0620c86ab4685c3557e1e2e6101c6575061549b7d10b4c875",
    "srv/SetGridMap": "4d47ec2cbb19fa8e05809708a85a6189a826891c8643e447366fff4936404f5f",
}
"""Of the branch jazzy; those of messages by rosbags, from its own files."""


@pytest.fixture(scope="module")
def served(shared_stage: Stage) -> tuple[User, Server]:
    server = shared_stage.start_world(WORLD)
    user = shared_stage.user
    user.listen(GridMap, "ground_truth/grid_map", LATCHED_QOS)
    user.listen(OccupancyGrid, "ground_truth/occupancy", LATCHED_QOS)
    user.listen(Detection3DArray, BOXES, SENSOR_QOS)
    options = [
        part for each in (f"address:={server.address}", *PARAMETERS) for part in ("-p", each)
    ]
    shared_stage.start_node("bridge", "--ros-args", *options)
    user.wait_until_ready()
    return user, server


def heights(user: User, points: list[Any], frame: str = "map") -> QueryHeight.Response:
    request = QueryHeight.Request(
        header=Header(frame_id=frame), points=[Point(x=x, y=y, z=z) for x, y, z in points]
    )
    answer: QueryHeight.Response = user.call(QueryHeight, "query_height", request)
    return answer


def test_heights_are_those_of_the_simulator(served: tuple[User, Server]) -> None:
    user, server = served
    points = [(0.0, 0.0, 9.0), (3.0, -2.0, 4.5), (1e6, 0.0, 0.0)]
    answer = heights(user, points)
    assert answer.success, answer.message
    assert answer.header.frame_id == "map"
    with server.client() as client:
        expected = client.query_height(points)
    np.testing.assert_array_equal(answer.ground_height, expected.ground_height_m)
    np.testing.assert_array_equal(answer.surface_height, expected.surface_height_m)
    np.testing.assert_array_equal(answer.clearance, expected.clearance_m)
    assert answer.surface_height[1] == pytest.approx(4.0, abs=1e-3)
    assert answer.ground_height[1] < 3.5


def test_a_world_of_no_place_has_no_longitudes(served: tuple[User, Server]) -> None:
    user, _ = served
    for kind, name in ((ToLonLat, "to_lon_lat"), (FromLonLat, "from_lon_lat")):
        answer = user.call(kind, name, kind.Request())
        assert not answer.success
        assert "stage.dem with a reference system" in answer.message


def test_points_may_be_in_a_frame_of_the_rig(served: tuple[User, Server]) -> None:
    user, _ = served
    assert user.set_pose(pose_looking_down(2.0, 3.0, 8.0)).success
    # Looking down, the optical axis is -z of the map.
    answer = heights(user, [(0.0, 0.0, 1.0)], "camera_optical_frame")
    assert answer.success, answer.message
    below = heights(user, [(2.0, 3.0, 7.0)])
    np.testing.assert_allclose(answer.clearance, below.clearance, atol=1e-6)


@pytest.mark.parametrize(
    ("points", "frame", "reason"),
    [
        ([(0.0, math.nan, 0.0)], "map", "points[0]: received"),
        ([(0.0, 0.0, 0.0)], "nowhere", "header.frame_id: received 'nowhere'"),
    ],
)
def test_what_is_no_point_is_refused(
    served: tuple[User, Server], points: list[Any], frame: str, reason: str
) -> None:
    answer = heights(served[0], points, frame)
    assert not answer.success
    assert reason in answer.message


def test_the_true_mesh_comes_in_the_answer_and_as_a_file(
    served: tuple[User, Server], tmp_path: Path
) -> None:
    user, server = served
    answer = user.call(GetGroundTruthMesh, "get_ground_truth_mesh", GetGroundTruthMesh.Request())
    assert answer.success, answer.message
    with server.client() as client:
        mesh = client.ground_truth_mesh()
        info = client.info()
    assert (answer.batch_id, answer.header.frame_id) == (info.batch_id, "map")
    np.testing.assert_array_equal(np.reshape(answer.vertices, (-1, 3)), mesh.vertices_m)
    np.testing.assert_array_equal(np.reshape(answer.triangles, (-1, 3)), mesh.triangles)
    assert mesh.semantic_ids is not None
    assert mesh.instance_ids is not None
    np.testing.assert_array_equal(answer.semantic_ids, mesh.semantic_ids)
    np.testing.assert_array_equal(answer.instance_ids, mesh.instance_ids)
    assert (STONE_ID, "stone") in {(each.id, each.name) for each in answer.labels}
    file = tmp_path / "new" / "truth.ply"
    request = GetGroundTruthMesh.Request(path=str(file))
    short = user.call(GetGroundTruthMesh, "get_ground_truth_mesh", request)
    assert short.success, short.message
    assert (len(short.vertices), short.triangle_count) == (0, len(mesh.triangles))
    np.testing.assert_array_equal(read_truth(file).triangles, mesh.triangles)
    request = GetGroundTruthMesh.Request(path=str(tmp_path / "truth.npz"))
    refused = user.call(GetGroundTruthMesh, "get_ground_truth_mesh", request)
    assert not refused.success
    assert "expected a file whose name ends with .ply" in refused.message
    assert not (tmp_path / "truth.npz").exists()
    request = GetGroundTruthMesh.Request(path="/proc/nowhere/truth.ply")
    assert not user.call(GetGroundTruthMesh, "get_ground_truth_mesh", request).success
    request = GetGroundTruthMesh.Request(path=f"/tmp/{'x' * 5000}.ply")
    refused = user.call(GetGroundTruthMesh, "get_ground_truth_mesh", request)
    assert not refused.success
    assert refused.message.startswith("path: received '/tmp/xxx")
    assert refused.message.endswith("expected at most 4095 bytes, and 255 for each name in it")
    # A folder called "~nosuchuser" was made where the bridge had been started.
    request = GetGroundTruthMesh.Request(path="~nosuchuser/truth.ply")
    refused = user.call(GetGroundTruthMesh, "get_ground_truth_mesh", request)
    assert not refused.success
    assert "not 'nosuchuser'" in refused.message


def maps_of(user: User, stamp: Any) -> tuple[GridMap, OccupancyGrid]:
    topics = ("ground_truth/grid_map", "ground_truth/occupancy")

    def found() -> tuple[GridMap, OccupancyGrid] | None:
        of_stamp = [[m for m in user.received[t] if m.header.stamp == stamp] for t in topics]
        return (of_stamp[0][0], of_stamp[1][0]) if all(of_stamp) else None

    maps: tuple[GridMap, OccupancyGrid] = user.wait_until(found)
    return maps


def test_a_reader_of_the_definitions_finds_the_true_ground(served: tuple[User, Server]) -> None:
    user, server = served
    answer = user.set_pose(pose_looking_at((1.1, -1.3, 8.0), (3.0, -2.0, 3.0)))
    assert answer.success, answer.message
    grid_map, occupancy = maps_of(user, answer.stamp)
    assert (grid_map.header.frame_id, occupancy.header.frame_id) == ("map", "map")
    assert list(grid_map.basic_layers) == ["elevation"]
    assert {"elevation", "slope", "roughness", "class", "traversability"} <= set(grid_map.layers)
    info = grid_map.info
    middle = (info.pose.position.x, info.pose.position.y)
    np.testing.assert_allclose(middle, (1.1, -1.3), atol=CELL_M)
    assert (info.length_x, info.resolution) == (LENGTH_M, CELL_M)
    assert occupancy.info.width * CELL_M == LENGTH_M

    rng = np.random.default_rng(5)
    offsets = rng.integers(-23, 23, (200, 2)) * CELL_M + CELL_M / 2
    places = [(middle[0] + dx, middle[1] + dy) for dx, dy in offsets]
    with server.client() as client:
        expected = client.query_height([(x, y, 0.0) for x, y in places]).surface_height_m
    found = [read_layer(grid_map, "elevation", x, y) for x, y in places]
    np.testing.assert_allclose(found, expected, atol=1e-3)
    for dx, dy in ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.25), (0.0, -0.75)):
        # The middle of the cell; above it, the ball's surface in closed form.
        x, y = (math.floor((at) / CELL_M) * CELL_M + CELL_M / 2 for at in (3.1 + dx, -1.9 + dy))
        ball_m = 3.0 + math.sqrt(1.0 - (x - 3.0) ** 2 - (y + 2.0) ** 2)
        assert read_layer(grid_map, "elevation", x, y) == pytest.approx(ball_m, abs=1e-3)
    for x, y in places:
        passable = read_layer(grid_map, "traversability", x, y)
        assert read_occupancy(occupancy, x, y) == round(100 * (1 - passable))
    assert read_layer(grid_map, "class", 3.0, -2.0) == STONE_ID
    assert read_occupancy(occupancy, 2.2, -2.0) == 100  # the ball's edge
    assert read_layer(grid_map, "class", -3.0, 2.0) != STONE_ID


def test_the_box_of_a_ball_is_where_the_camera_looks(served: tuple[User, Server]) -> None:
    user, _ = served
    eye_m = (-3.0, 1.0, 6.0)
    answer = user.set_pose(pose_looking_at(eye_m, (3.0, -2.0, 3.0)))
    boxes = user.received[BOXES]
    user.wait_until(lambda: boxes and boxes[-1].header.stamp == answer.stamp)
    assert boxes[-1].header.frame_id == "camera_optical_frame"
    (ball,) = boxes[-1].detections
    centre, size = ball.bbox.center.position, ball.bbox.size
    np.testing.assert_allclose([size.x, size.y, size.z], 2.0, atol=1e-9)
    away_m = math.dist(eye_m, (3.0, -2.0, 3.0))
    np.testing.assert_allclose([centre.x, centre.y, centre.z], [0, 0, away_m], atol=1e-6)
    assert ball.results[0].hypothesis.class_id == str(STONE_ID)
    before = len(boxes)
    answer = user.set_pose(pose_looking_down(-12.0, 12.0, 9.0))  # no ball
    user.wait_until(lambda: len(boxes) > before)
    assert (list(boxes[-1].detections), boxes[-1].header.stamp) == ([], answer.stamp)


def test_each_sample_has_a_map_and_the_maps_follow_the_rig(served: tuple[User, Server]) -> None:
    user, _ = served
    for x_m in (-2.0, 0.0, 2.0):
        answer = user.set_pose(pose_looking_down(x_m, 0.0, 9.0))
        grid_map, _ = maps_of(user, answer.stamp)
        assert abs(grid_map.info.pose.position.x - x_m) <= CELL_M
        assert nanoseconds(grid_map.header.stamp) == nanoseconds(answer.stamp)


def test_grid_maps_have_the_official_type_hashes() -> None:
    share = Path(sys.prefix, "share", "grid_map_msgs")
    for name, expected in HASHES.items():
        definition = json.loads((share / f"{name}.json").read_text())
        hashes = {each["type_name"]: each["hash_string"] for each in definition["type_hashes"]}
        assert hashes[f"grid_map_msgs/{name}"] == f"RIHS01_{expected}"
