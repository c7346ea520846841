"""A planner over ROS 2: asks the bridge for views from a few poses, one after another.

    python examples/03_planner.py [--timeout SECONDS]

It knows ROS 2 and `oaisys_msgs` alone, may be started before the bridge, and waits for nothing
without a deadline. Exit 0: all views were rendered; 1: it says which was not, and why.
"""

from __future__ import annotations

import argparse
import sys

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.client import Client
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from std_msgs.msg import Bool, Header

from oaisys_msgs.srv import SetPose

VIEWPOINTS_M = ((-4.0, 0.0, 8.0), (0.0, 0.0, 8.0), (4.0, 0.0, 8.0))
"""x, y, z of the rig in `map`; it looks along +x, as no turn has it."""


def look_from(
    node: Node, client: Client, position_m: tuple[float, float, float], timeout_s: float
) -> Future:
    """Ask for a view; return the answer's future, done unless time was up before."""
    if not client.wait_for_service(timeout_sec=timeout_s):
        raise TimeoutError(f"nobody offers {client.srv_name} after {timeout_s:g} s")
    pose = PoseStamped(header=Header(frame_id="map"))  # of the rig: x forward, y left, z up
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = position_m
    pose.pose.orientation.w = 1.0
    answer = client.call_async(SetPose.Request(pose=pose))
    rclpy.spin_until_future_complete(node, answer, timeout_sec=timeout_s)
    return answer  # once it is done, all of the sample has been published, with one stamp


def wait_until_ready(node: Node, timeout_s: float) -> None:
    """Wait until a world stands: the bridge says so on a latched topic, however late it comes."""
    ready = Future()

    def on_ready(message: Bool) -> None:
        if message.data and not ready.done():
            ready.set_result(True)

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(Bool, "oaisys_bridge/ready", on_ready, latched)
    rclpy.spin_until_future_complete(node, ready, timeout_sec=timeout_s)
    if not ready.done():
        raise TimeoutError(f"no bridge was ready after {timeout_s:g} s")


def fly(node: Node, timeout_s: float) -> None:
    """Look from every viewpoint; raise where one of them brings no view."""
    # Made first of all: who is told that the bridge is ready is known to it, with all made before.
    # Fast DDS drops answers to clients that their service does not know yet.
    client = node.create_client(SetPose, "oaisys_bridge/set_pose")
    wait_until_ready(node, timeout_s)
    for position_m in VIEWPOINTS_M:
        future = look_from(node, client, position_m, timeout_s)
        if not future.done():
            raise TimeoutError(f"no answer to the view from {position_m} after {timeout_s:g} s")
        answer = future.result()
        if not answer.success:
            raise RuntimeError(f"the view from {position_m} was refused: {answer.message}")
        stamp_s = answer.stamp.sec + 1e-9 * answer.stamp.nanosec
        print(f"batch {answer.batch_id} sample {answer.sample_id} stamp {stamp_s:.6f}", flush=True)


def main() -> int:
    """Run the planner and return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timeout", type=float, default=120.0, help="seconds for each wait")
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    rclpy.init(args=sys.argv)
    node = Node("planner")
    try:
        fly(node, options.timeout)
    except (TimeoutError, RuntimeError) as error:
        print(f"planner: {error}", file=sys.stderr)
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
