"""A planner of the mav family explores a hill: it knows its own topics, and is only remapped."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from repository import REPOSITORY
from ros_peer import Stage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from served_simulator import FLAT_WORLD
from waiting import PATIENCE_S

from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.clouds import cloud_from_msg
from oaisys_ros_bridge.qos import SMALL_MESSAGE_QOS

pytestmark = pytest.mark.ros

PLANNER = Path(__file__).parents[1] / "mav_planner.py"
PAGE = REPOSITORY / "docs" / "ros.md"
CELL_M, EDGE_M = 0.5, 32.0
TOP_M, TOP_XY_M, WIDTH_M = 6.0, (2.0, -1.0), 3.5
BOUNDS_M = 12.0
"""Half of the edge of what is to be explored."""
START_M = (-9.0, 0.0, 5.0)


def height_m(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
    """Return the height of the hill, a Gaussian, in closed form."""
    away = (x - TOP_XY_M[0]) ** 2 + (y - TOP_XY_M[1]) ** 2
    return np.asarray(TOP_M * np.exp(-away / (2 * WIDTH_M**2)))


def write_hill(file: Path) -> None:
    """Write the hill as an ESRI ASCII grid, whose first row is in the north."""
    steps_m = np.arange(-EDGE_M / 2, EDGE_M / 2 + CELL_M / 2, CELL_M)
    x, y = np.meshgrid(steps_m, steps_m[::-1])
    corner_m = -(EDGE_M + CELL_M) / 2
    head = (
        f"ncols {len(steps_m)}\nnrows {len(steps_m)}\nxllcorner {corner_m}\nyllcorner {corner_m}\n"
        f"cellsize {CELL_M}\n"
    )
    rows = "\n".join(" ".join(f"{z:.6f}" for z in row) for row in height_m(x, y))
    file.write_text(head + rows + "\n")


def world(folder: Path) -> dict[str, Any]:
    """Return the hill, seen by a multicopter's camera, which looks half a radian down."""
    write_hill(folder / "hill.asc")
    camera = {
        "width_px": 80,
        "height_px": 60,
        "fx_px": 53.0,
        "fy_px": 53.0,
        "modalities": ["depth"],
        "mount_quat_xyzw": [0.0, math.sin(0.25), 0.0, math.cos(0.25)],
    }
    return {
        **FLAT_WORLD,
        "stage": {"dem": {"file": str(folder / "hill.asc"), "spacing_m": CELL_M, "offset_m": 0.0}},
        "sensors": {"cameras": [camera], "start_pose": {"position_m": list(START_M)}},
    }


def documented_remapping() -> list[str]:
    """Return the arguments of the planner in docs/ros.md."""
    found = re.search(r"mav_planner\.py --ros-args((?: -r \S+)+)", PAGE.read_text("utf-8"))
    assert found is not None
    return found[1].split()


def seen_points(stage: Stage) -> list[NDArray[Any]]:
    """Return the points of each cloud in `map`, by the odometry of its stamp."""
    received = stage.user.received
    poses = {str(m.header.stamp): m.pose.pose for m in received["odometry"]}
    optical = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    mount = Rotation.from_euler("y", 0.5)
    clouds = []
    for message in received["camera/depth_registered/points"]:
        pose = poses[str(message.header.stamp)]
        q, p = pose.orientation, pose.position
        points_m = cloud_from_msg(message)[0].reshape(-1, 3)
        points_m = points_m[np.isfinite(points_m).all(axis=1)]
        turn = Rotation.from_quat([q.x, q.y, q.z, q.w]) * mount * optical
        clouds.append(turn.apply(points_m) + np.array([p.x, p.y, p.z]))
    return clouds


def coverage(points_m: NDArray[Any]) -> float:
    """Return the share of the true hill within bounds that has a point within half a metre."""
    steps_m = np.arange(-BOUNDS_M + 0.25, BOUNDS_M, 0.5)
    x, y = np.meshgrid(steps_m, steps_m)
    true_m = np.stack((x, y, height_m(x, y)), axis=-1).reshape(-1, 3)
    away_m, _ = cKDTree(points_m).query(true_m, distance_upper_bound=0.5)
    return float(np.isfinite(away_m).mean())


@pytest.mark.long
def test_a_planner_of_the_mav_family_explores_a_hill_by_remapping_alone(
    stage: Stage, tmp_path: Path
) -> None:
    user = stage.user
    user.listen(Odometry, "odometry", SMALL_MESSAGE_QOS)
    user.listen(PointCloud2, "camera/depth_registered/points", SMALL_MESSAGE_QOS)
    user.listen(SampleInfo, "oaisys_bridge/sample_info", SMALL_MESSAGE_QOS)
    stage.start_bridge(stage.start_world(world(tmp_path)).address)
    user.wait_until_ready()
    command = [sys.executable, str(PLANNER), "--ros-args", *documented_remapping()]
    with (tmp_path / "planner.log").open("w") as log:
        planner = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            user.wait_until(lambda: planner.poll() is not None, 3 * PATIENCE_S)
        finally:
            planner.kill()
            planner.wait()
    said = (tmp_path / "planner.log").read_text()
    assert planner.returncode == 0, said
    samples = user.received["oaisys_bridge/sample_info"]
    found = re.search(r"explored: (\d+) views, (\d+) of them asked for again", said)
    assert found is not None, said
    # On a busy machine the planner may ask for a view again that is still being rendered.
    views, again = map(int, found.groups())
    user.wait_until(
        lambda: len(samples) >= views, explain=lambda: f"{len(samples)} samples: {said}"
    )
    assert len(samples) <= views + again
    points = user.received["camera/depth_registered/points"]
    user.wait_until(lambda: len(points) >= len(samples))

    clouds = seen_points(stage)
    assert len(clouds) == len(samples)
    points_m = np.concatenate(clouds)
    near = (np.abs(points_m[:, :2]) < EDGE_M / 2 - 1).all(axis=1)
    errors_m = points_m[near, 2] - height_m(*points_m[near, :2].T)
    assert np.abs(errors_m).max() < 0.05  # between posts, triangles are not the Gaussian
    places_m = np.array([(p.x, p.y, p.z) for p in (s.rig_pose.position for s in samples)])
    assert (places_m[:, 2] - height_m(*places_m[:, :2].T)).min() > 0.5
    assert coverage(np.concatenate(clouds[:4])) < 0.7  # one turn does not see behind the hill
    assert coverage(points_m) > 0.9  # what `oaisys explore` calls explored
