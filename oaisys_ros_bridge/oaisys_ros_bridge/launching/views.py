"""RViz on the simulator's topics, in any namespace and with any frames."""

from __future__ import annotations

from pathlib import Path

import launch.logging
from launch_ros.actions import Node

from oaisys_ros_bridge.namespaces import TF, TF_STATIC

TOPIC = "Value: /"
FIXED_FRAME = "Fixed Frame: map"


def rviz(
    config: Path, namespace: str = "", frame_prefix: str = "", *, follows: bool = False
) -> Node:
    """Return RViz with the displays of a file.

    Args:
        config: For the root namespace; a copy in the launch's log folder has other names.
        namespace: Of the simulator.
        frame_prefix: Of the simulator's frames, which are then on the common ``/tf``.
        follows: Whether it follows ``/clock``.
    """
    text = config.read_text(encoding="utf-8")
    moved = text
    if namespace:
        moved = moved.replace(TOPIC, f"{TOPIC}{namespace.strip('/')}/")
    moved = moved.replace(FIXED_FRAME, f"Fixed Frame: {frame_prefix}map")
    file = config
    if moved != text:
        file = Path(launch.logging.launch_config.log_dir, config.name)
        file.write_text(moved, encoding="utf-8")
    own_tf = (TF, TF_STATIC) if namespace and not frame_prefix else ()
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=["-d", str(file)],
        parameters=[{"use_sim_time": follows}],
        remappings=[(topic, topic.removeprefix("/")) for topic in (TF, TF_STATIC)]
        if own_tf
        else [],
    )
