"""What can be said to the launch files. No launch system in here: any machine can read it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from oaisys_ros_bridge.parameters.node_settings import LOG_LEVELS

SWITCH = ("true", "false")


@dataclass(frozen=True)
class Argument:
    """What can be said on the command line.

    Attributes:
        default: As text.
        description: One sentence.
        choices: All that it may be; none: anything.
    """

    default: str
    description: str
    choices: tuple[str, ...] = ()


CONFIG = Argument("", "YAML file that describes the world and its cameras; empty: the usual one.")
BACKEND = Argument(
    "",
    "What renders; empty: as the configuration says.",
    ("", "blender", "analytic"),
)
WORKER_PYTHON = Argument(
    "", "Python interpreter that has bpy; empty: the one that runs the server."
)
NAMESPACE = Argument(
    "",
    "ROS namespace of all nodes and topics; /tf and /tf_static become NAMESPACE/tf and "
    "NAMESPACE/tf_static, so that simulators run side by side. /clock and /diagnostics stay.",
)
RVIZ = Argument("false", "Whether to open RViz with everything in view, once it is ready.", SWITCH)


PARAMS_FILE = Argument(
    "",
    "YAML file of ROS parameters for any of the nodes: oaisys_bridge, oaisys_mapper, "
    "oaisys_recorder.",
)
LOG_LEVEL = Argument("", "Log level of all nodes; empty: ROS's own.", ("", *LOG_LEVELS))
USE_SIM_TIME = Argument(
    "false",
    "Whether nodes follow /clock; not the bridge where the parameters say publish_clock.",
    SWITCH,
)
NODES = {"params_file": PARAMS_FILE, "log_level": LOG_LEVEL, "use_sim_time": USE_SIM_TIME}
"""What is asked of all nodes."""

SIMULATOR = {
    "config": CONFIG,
    "address": Argument(
        "127.0.0.1:50051",
        "Where the simulator serves gRPC, host:port; port 0: any free one, for a second simulator.",
    ),
    "backend": BACKEND,
    "namespace": NAMESPACE,
    "frame_prefix": Argument(
        "",
        "Put before the names of all frames, such as mars/; then TF stays on the common /tf.",
    ),
    "mapper": Argument("true", "Whether to rebuild the surface.", SWITCH),
    "record": Argument(
        "false", "true records all topics of the namespace to a new bag_DATE; a path, to there."
    ),
    "recorder": Argument(
        "auto",
        "What records: ros2 bag record, or this package's recorder, which flushes every message;"
        " auto: the former where it is installed.",
        ("auto", "ros2", "oaisys"),
    ),
    "rviz": RVIZ,
    "worker_python": WORKER_PYTHON,
    **NODES,
}
"""Of ``simulator.launch.py``."""

_EXPERIMENT = {
    "config": CONFIG,
    "backend": BACKEND,
    "seed": Argument("", "Root seed of the world; empty: as configured."),
    "size": Argument("", "WIDTHxHEIGHT of the images, for a quick look; empty: as configured."),
    "quality": Argument("", "Of colour, preview to final; empty: as configured."),
    "voxel_size": Argument("0.1", "Voxel size of the map, metres."),
    "key": Argument("", "PEM file of an Ed25519 key that signs the certificate; empty: none."),
    "namespace": NAMESPACE,
    "worker_python": WORKER_PYTHON,
    "record": Argument("true", "Whether everything is recorded as a rosbag2 MCAP.", SWITCH),
    **NODES,
}
SURVEY = {
    "out": Argument("out/survey", "Folder for report, mesh, pictures and bag."),
    "views": Argument("30", "How many viewpoints the grid has."),
    "altitude": Argument("10.0", "Metres above the ground below."),
    "overlap": Argument("0.35", "Share of an image that neighbours share."),
    "max_range": Argument("60.0", "Metres of depth that are mapped."),
    "seeds": Argument("", "How many worlds, or their seeds with commas between them; empty: one."),
    "faults": Argument("true", "Whether to show what maps with deliberate faults come to.", SWITCH),
    **_EXPERIMENT,
}
"""Of ``survey.launch.py``, beside ``rviz``: each is an option of ``oaisys survey``."""

EXPLORE = {
    "out": Argument("out/explore", "Folder for report, mesh, pictures and bag."),
    "planner": Argument(
        "next_best_view", "next_best_view, frontier, grid, random, or a package's; all: those."
    ),
    "compare": Argument("false", "Whether all others explore the same worlds, too.", SWITCH),
    "seeds": Argument("1", "How many worlds, or their seeds with commas between them."),
    "via": Argument(
        "service", "How poses are asked for: by the service, or flown.", ("service", "trajectory")
    ),
    "views": Argument("60", "Most views of an exploration."),
    "baseline_views": Argument("400", "Most views of every planner but the first."),
    "until": Argument("", "Share of the reachable surface to see; empty: 0.95, compared 0.9."),
    "path": Argument("20000.0", "Longest path that is flown, metres."),
    "planning_voxel": Argument("0.5", "Of the map that plans are made on, metres."),
    "radius": Argument("1.0", "Radius of the vehicle, metres."),
    "camera_range": Argument("20.0", "Depth that is used, metres."),
    "start_height": Argument("3.0", "Metres over the ground at the start."),
    **_EXPERIMENT,
}
"""Of ``explore.launch.py``, beside ``rviz``: each is an option of ``oaisys explore``."""

OPTIONS = {"record": "bag"}
"""Arguments whose option has another name."""


def command_line(arguments: Mapping[str, Argument], values: Mapping[str, str]) -> list[str]:
    """Return the options of an experiment's command; what is as usual is left out."""
    line: list[str] = []
    for name, argument in arguments.items():
        option, value = OPTIONS.get(name, name).replace("_", "-"), values[name]
        if value == argument.default:
            continue
        if argument.choices == SWITCH:
            line.append(f"--{option}" if value == "true" else f"--no-{option}")
        else:
            line += [f"--{option}", value]
    return line


def ros_environment() -> dict[str, str]:
    """Return the ROS domain of the launch, for programs that would take one of their own."""
    return {"ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "0")}
