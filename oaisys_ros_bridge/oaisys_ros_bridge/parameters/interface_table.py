"""The topics, services and actions of mapper and recorder, one row each, and what a row is.

A test compares the rows with running nodes. No ROS in here: the reference page is generated from
the rows on any machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class InterfaceKind(Enum):
    """What kind of interface a row describes."""

    PUBLISHED = "published"
    SUBSCRIBED = "subscribed"
    SERVICE = "service"
    ACTION = "action"


SENSOR = "reliable, depth 5"
LATCHED = "reliable, latched, depth 1"
LATCHED_HISTORY = "reliable, latched, depth 100"
DEFAULT = "reliable, depth 10"
DEEP = "reliable, depth 50"
SMALL_MESSAGES = "reliable, depth 1000"
MOTION = "reliable, depth 5000"


@dataclass(frozen=True)
class Interface:
    """One topic, service or action of a node.

    Attributes:
        name: As the node gives it; ``~`` is the node's own name, ``camera`` stands for a sensor,
            ``N`` for a semantic level.
        type_name: Such as ``sensor_msgs/msg/Image``.
        description: With units and encoding.
        qos: Of a topic.
    """

    kind: InterfaceKind
    name: str
    type_name: str
    description: str
    qos: str = ""


def ground_map_interfaces(prefix: str, which: str) -> tuple[Interface, ...]:
    """Return the maps of the ground of a node."""
    return (
        Interface(
            InterfaceKind.PUBLISHED,
            f"{prefix}grid_map",
            "grid_map_msgs/msg/GridMap",
            f"The ground around the rig, {which}: layers elevation (m), slope (rad), roughness and "
            "step (m), traversability (1 to 0), class; see `ground_map.*`.",
            LATCHED,
        ),
        Interface(
            InterfaceKind.PUBLISHED,
            f"{prefix}occupancy",
            "nav_msgs/msg/OccupancyGrid",
            "The same for a rover: 0 is level and smooth, 100 impassable, -1 unknown.",
            LATCHED,
        ),
    )


MAPPER_INTERFACES = (
    Interface(
        InterfaceKind.SUBSCRIBED,
        "camera/depth/image_raw",
        "sensor_msgs/msg/Image",
        "`32FC1` in metres or `16UC1` in millimetres. `camera` is a parameter.",
        DEEP,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "camera/depth/camera_info",
        "sensor_msgs/msg/CameraInfo",
        "Its camera.",
        DEEP,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "camera/color/image_raw",
        "sensor_msgs/msg/Image",
        "Of the same stamp.",
        DEEP,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "camera/color/camera_info",
        "sensor_msgs/msg/CameraInfo",
        "Its camera, if that is not the depth camera.",
        DEEP,
    ),
    Interface(InterfaceKind.SUBSCRIBED, "/tf", "tf2_msgs/msg/TFMessage", "Poses.", SMALL_MESSAGES),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        "Mounts.",
        LATCHED_HISTORY,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "oaisys_bridge/sample_info",
        "oaisys_msgs/msg/SampleInfo",
        "Which samples are complete, and which messages they have.",
        SMALL_MESSAGES,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "oaisys_bridge/configuration",
        "std_msgs/msg/String",
        "Tells whether the bridge began after the mapper, which then expects all samples.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "oaisys_bridge/batch",
        "oaisys_msgs/msg/SampleInfo",
        "Another world: the map is cleared.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/mesh",
        "visualization_msgs/msg/Marker",
        "Triangles with colours, metres in the map frame.",
        LATCHED,
    ),
    *ground_map_interfaces("~/", "as mapped"),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/surface_points",
        "sensor_msgs/msg/PointCloud2",
        "The mesh's vertices.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/esdf_slice",
        "sensor_msgs/msg/PointCloud2",
        "x, y, z and `intensity`: the distance to the mapped surface at a height, in metres, "
        "negative behind it; with `esdf.length_m`.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/metrics",
        "oaisys_msgs/msg/MapStatus",
        "Frames received, integrated, dropped; seconds for the last one; figures as JSON; samples "
        "announced and incomplete, and what is missing; what the middleware lost.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "oaisys_bridge/receipts",
        "oaisys_msgs/msg/SampleReceipt",
        "Up to which sample all are in the map, and what is missing.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/save_mesh",
        "oaisys_msgs/srv/SaveMesh",
        "Write the mesh (.ply) or the volume itself (.npz, the same bytes for the same frames).",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/evaluate",
        "oaisys_msgs/srv/Evaluate",
        "Compare the map with a true mesh.",
    ),
    Interface(InterfaceKind.SERVICE, "~/reset", "std_srvs/srv/Trigger", "Clear the map."),
)

RECORDER_INTERFACES = (
    Interface(
        InterfaceKind.PUBLISHED,
        "oaisys_bridge/receipts",
        "oaisys_msgs/msg/SampleReceipt",
        "Up to which sample all are in the bag, and what is missing; of each bridge.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/recording",
        "std_msgs/msg/Bool",
        "Whether all requested topics are being recorded; false once the bag cannot be written, "
        "as on a full disk: the recorder then ends with exit code 1.",
        LATCHED,
    ),
)
