"""A receding-horizon planner of the mav family, which knows the topics of that family alone.

Names and types are those of voxblox and mav_active_3d_planning: it takes `pointcloud` with
`transform` (voxblox without TF), and `odometry`; it publishes `command/trajectory`. What is space
and what is ground it knows from its own map of voxels. It samples poses, weighs the unknown volume
that each would see against the way there (Bircher et al., ICRA 2016), flies to the best one in a
straight line through known free space, and ends once nothing is left to see.

Exit code 0: explored; 1: it says on what it waited in vain.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.node import Node
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

Array = NDArray[Any]
Pose = tuple[Array, float]
"""Position and yaw."""
PATIENCE_S = 60.0
AGAIN_S = 10.0
UNKNOWN, FREE, OCCUPIED, OUTSIDE = 0, 1, 2, 3
PARAMETERS = {
    "bounds": [-12.0, -12.0, -1.0, 12.0, 12.0, 7.0],  # x, y, z of the least and the largest corner
    "voxel_size": 0.5,
    "ray_length": 18.0,
    "camera_pitch": 0.5,  # downwards; of its mount on base_link
    "fov": [1.3, 1.0],  # horizontal and vertical
    "robot_radius": 0.7,
    "speed": 2.0,
    "point_spacing": 4.0,  # along a trajectory
    "least_gain": 75.0,  # m³
    "most_views": 50,
}


class Voxels:
    """What is known of a box: free along rays, occupied at their ends; nothing else."""

    def __init__(self, bounds: list[float], size_m: float) -> None:
        self.low, self.size_m = np.array(bounds[:3]), size_m
        shape = np.ceil((np.array(bounds[3:]) - self.low) / size_m).astype(int)
        self.state = np.full(shape, UNKNOWN, np.uint8)

    def integrate(self, origin: Array, points: Array, most_m: float) -> None:
        """Carve the rays from the camera to points, and mark those that are in reach."""
        ways = points - origin
        lengths = np.linalg.norm(ways, axis=1)
        steps_m = np.arange(0.0, most_m, self.size_m / 2)
        along = origin + ways[:, None] / lengths[:, None, None] * steps_m[:, None]
        before = steps_m < np.minimum(lengths, most_m)[:, None] - self.size_m
        cells, inside = self.cells(along[before])
        free = tuple(cells[inside].T)
        self.state[free] = np.where(self.state[free] == OCCUPIED, OCCUPIED, FREE)
        cells, inside = self.cells(points[lengths < most_m])
        self.state[tuple(cells[inside].T)] = OCCUPIED

    def cells(self, points: Array) -> tuple[Array, Array]:
        """Return the indices of points, and which of them are in the box."""
        cells = np.floor((points - self.low) / self.size_m).astype(int)
        return cells, ((cells >= 0) & (cells < self.state.shape)).all(axis=-1)

    def look_up(self, points: Array) -> Array:
        """Return the states at points."""
        cells, inside = self.cells(points)
        cells = np.where(inside[..., None], cells, 0)
        return np.where(inside, self.state[tuple(np.moveaxis(cells, -1, 0))], OUTSIDE)


class Planner(Node):
    """Turns once, and then flies from one best view to the next."""

    def __init__(self) -> None:
        super().__init__("mav_planner")
        self._values = {
            name: self.declare_parameter(name, default).value
            for name, default in PARAMETERS.items()
        }
        self.is_done = False
        self._since_s = self._asked_s = time.monotonic()
        self._rng = np.random.default_rng(3)
        self._voxels = Voxels(self._values["bounds"], self._values["voxel_size"])
        self._pose: Pose | None = None
        self._begin: Pose | None = None
        self._goal: Pose | None = None
        self._command = MultiDOFJointTrajectory()
        self._arrived: int | None = None
        self._views, self._asked_again = 0, 0
        self._clouds: dict[int, PointCloud2] = {}
        self._transforms: dict[int, TransformStamped] = {}
        self._integrated = -1
        self._commands = self.create_publisher(MultiDOFJointTrajectory, "command/trajectory", 1)
        self.create_subscription(Odometry, "odometry", self._on_odometry, 10)
        self.create_subscription(PointCloud2, "pointcloud", self._on_cloud, 50)
        self.create_subscription(TransformStamped, "transform", self._on_transform, 50)

    def _on_odometry(self, message: Odometry) -> None:
        pose = message.pose.pose
        q = pose.orientation
        yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
        position = pose.position
        self._pose = (np.array([position.x, position.y, position.z]), yaw)
        if self._goal is not None and self._arrived is None and is_same(self._pose, self._goal):
            self._arrived = nanoseconds(message)

    def _on_cloud(self, message: PointCloud2) -> None:
        self._clouds[nanoseconds(message)] = message
        self._integrate()

    def _on_transform(self, message: TransformStamped) -> None:
        self._transforms[nanoseconds(message)] = message
        self._integrate()

    def _integrate(self) -> None:
        """Put clouds into the map whose transforms have come."""
        for stamp in sorted(self._clouds.keys() & self._transforms.keys()):
            transform = self._transforms.pop(stamp).transform
            points = points_of(self._clouds.pop(stamp))
            t, r = transform.translation, transform.rotation
            origin = np.array([t.x, t.y, t.z])
            in_world = Rotation.from_quat([r.x, r.y, r.z, r.w]).apply(points) + origin
            self._voxels.integrate(origin, in_world[::4], self._values["ray_length"])
            self._integrated = stamp

    def act(self) -> None:
        """Give the next command once the last one's view is in the map."""
        now_s = time.monotonic()
        if now_s > self._since_s + PATIENCE_S:
            raise TimeoutError(f"waited {PATIENCE_S:g} s for odometry and cloud at {self._goal}")
        if self._pose is None or not self._commands.get_subscription_count():
            return
        if self._goal is None:
            position, yaw = self._pose
            # Not back to where it began, or an odometry of before would say that it is there.
            turns = (np.arange(4) + 0.5) * math.pi / 2
            self._fly([(position, yaw + turn) for turn in turns])
        elif self._arrived is not None:
            if self._integrated >= self._arrived:
                self._plan()
        elif now_s > self._asked_s + AGAIN_S and is_same(self._pose, self._begin):
            # Who flies may not have known this publisher yet; or else it flies there twice.
            self._asked_again += len(self._command.points)
            self._publish()

    def _plan(self) -> None:
        best = None
        if self._views < self._values["most_views"]:
            best = self._best_view()
        if best is None:
            known = float((self._voxels.state != UNKNOWN).mean())
            views = f"{self._views} views, {self._asked_again} of them asked for again"
            self.get_logger().info(f"explored: {views}, {known:.3f} of the box known")
            self.is_done = True
            return
        assert self._pose is not None
        position, _ = self._pose
        goal, yaw = best
        count = max(math.ceil(np.linalg.norm(goal - position) / self._values["point_spacing"]), 1)
        ways = [position + (goal - position) * (i + 1) / count for i in range(count)]
        self._fly([(each, yaw) for each in ways])

    def _best_view(self) -> Pose | None:
        """Return the pose with the largest gain, less the longer the way; None: nothing to see."""
        assert self._pose is not None
        position, _ = self._pose
        reachable = self._reachable(position)
        best, best_worth = None, 0.0
        for goal in reachable:
            discount = math.exp(-np.linalg.norm(goal - position) / 20.0)
            for yaw, gain in self._gains(goal):
                if is_same((goal, yaw), self._pose):
                    continue
                if gain > self._values["least_gain"] and gain * discount > best_worth:
                    best, best_worth = (goal, yaw), gain * discount
        return best

    def _reachable(self, position: Array) -> Array:
        """Return places that a straight way through known free space leads to, and this one."""
        voxels = self._voxels
        away_m = distance_transform_edt(voxels.state == FREE, sampling=voxels.size_m)
        cells = np.argwhere(away_m > self._values["robot_radius"])
        if not len(cells):
            return position[None]
        chosen = self._rng.choice(cells, min(len(cells), 60), replace=False)
        places = voxels.low + (chosen + 0.5) * voxels.size_m
        shares = np.linspace(0.0, 1.0, 100)[:, None]
        ways = position + (places - position)[:, None] * shares
        indices, inside = voxels.cells(ways)
        away = away_m[tuple(np.moveaxis(np.where(inside[..., None], indices, 0), -1, 0))]
        near = np.linalg.norm(ways - position, axis=-1) < 2 * voxels.size_m  # it is there already
        clear = (near | (inside & (away > self._values["robot_radius"]))).all(axis=1)
        return np.concatenate((position[None], places[clear]))

    def _gains(self, place: Array) -> list[tuple[float, float]]:
        """Return yaws, and the unknown volume in m³ that a camera sees there before any ground."""
        wide, high = self._values["fov"]
        tilt = self._values["camera_pitch"]
        step_m = self._voxels.size_m
        lengths = np.arange(step_m, self._values["ray_length"], step_m)
        yaws = np.arange(0.0, 2 * math.pi, math.pi / 12)
        pitches = tilt + np.linspace(-high / 2, high / 2, 10)
        turned, tilted = np.meshgrid(yaws, pitches, indexing="ij")
        rays = np.stack(
            (np.cos(tilted) * np.cos(turned), np.cos(tilted) * np.sin(turned), -np.sin(tilted)),
            axis=-1,
        )
        states = self._voxels.look_up(place + rays[..., None, :] * lengths[:, None])
        seen = np.cumsum(states == OCCUPIED, axis=-1) == 0
        # Each sample stands for the volume around it: dV = r² cos(pitch) dr dpitch dyaw.
        solid = np.cos(pitches) * (yaws[1] - yaws[0]) * (pitches[1] - pitches[0])
        by_yaw = ((states == UNKNOWN) & seen) @ (lengths**2 * step_m) * solid
        in_view = max(int(wide / (yaws[1] - yaws[0])), 1)
        around = [np.roll(by_yaw.sum(axis=1), -shift) for shift in range(in_view)]
        middle = (in_view - 1) / 2 * (yaws[1] - yaws[0])
        return list(zip((yaws + middle).tolist(), np.sum(around, axis=0).tolist(), strict=True))

    def _fly(self, poses: list[Pose]) -> None:
        """Publish a trajectory with yaw alone, as a multicopter flies it."""
        self._begin, self._goal, self._arrived = self._pose, poses[-1], None
        self._views += len(poses)
        self._since_s = time.monotonic()
        message = MultiDOFJointTrajectory(joint_names=["base_link"])
        spacing_s = self._values["point_spacing"] / self._values["speed"]
        for index, (position, yaw) in enumerate(poses):
            x, y, z = position.tolist()
            turn = Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))
            transform = Transform(translation=Vector3(x=x, y=y, z=z), rotation=turn)
            after = Duration(seconds=index * spacing_s).to_msg()
            point = MultiDOFJointTrajectoryPoint(transforms=[transform], time_from_start=after)
            message.points.append(point)
        self._command = message
        self._publish()

    def _publish(self) -> None:
        self._asked_s = time.monotonic()
        self._command.header.stamp = self.get_clock().now().to_msg()
        self._commands.publish(self._command)


def is_same(one: Pose, other: Pose | None) -> bool:
    """Return whether two poses are the same to a few centimetres and degrees."""
    if other is None:
        return False
    turn = (one[1] - other[1] + math.pi) % (2 * math.pi) - math.pi
    return bool(np.linalg.norm(one[0] - other[0]) < 0.1 and abs(turn) < 0.05)


def nanoseconds(message: Any) -> int:
    """Return the stamp of a message."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def points_of(message: PointCloud2) -> Array:
    """Return the (N, 3) finite points of a cloud, in its frame."""
    offsets = {field.name: field.offset for field in message.fields}
    kind = np.dtype(
        {
            "names": list("xyz"),
            "formats": ["<f4"] * 3,
            "offsets": [offsets[axis] for axis in "xyz"],
            "itemsize": message.point_step,
        }
    )
    cloud = np.frombuffer(message.data, kind)
    points = np.stack([cloud[axis] for axis in "xyz"], axis=-1).astype(float)
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def main() -> int:
    """Explore until there is nothing left to see."""
    rclpy.init(args=sys.argv)
    planner = Planner()
    try:
        while not planner.is_done:
            rclpy.spin_once(planner, timeout_sec=0.1)
            planner.act()
    except TimeoutError as error:
        planner.get_logger().error(str(error))
        return 1
    finally:
        planner.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
