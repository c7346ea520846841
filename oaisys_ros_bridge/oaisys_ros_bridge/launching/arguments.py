"""The arguments of the launch files, without imports of the launch system."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from oaisys_ros_bridge.namespaces import DOMAIN_VARIABLE
from oaisys_ros_bridge.parameters.node_settings import LOG_LEVELS

SWITCH = ("true", "false")


@dataclass(frozen=True)
class Argument:
    """An argument of a launch file.

    Attributes:
        default: As text.
        description: One sentence.
        choices: Its possible values; empty: any.
    """

    default: str
    description: str
    choices: tuple[str, ...] = ()


CONFIG = Argument(
    "", "YAML file that describes the world and its sensors; empty: the default world."
)
BACKEND = Argument(
    "",
    "Renderer; empty: as configured.",
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
RVIZ = Argument("false", "Whether to open RViz once the bridge is ready.", SWITCH)


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
"""Settings of all nodes."""

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
        "Prefix of all frame names, such as mars/; TF then stays on the common /tf.",
    ),
    "mapper": Argument(
        "true", "Whether to run the mapper, which reconstructs the surface.", SWITCH
    ),
    "record": Argument(
        "false", "true records all topics of the namespace to a new bag_DATE; a path, to there."
    ),
    "recorder": Argument(
        "auto",
        "Program that records: ros2 bag record, or this package's recorder, which writes every "
        "message immediately; auto: ros2 bag record where it is installed.",
        ("auto", "ros2", "oaisys"),
    ),
    "rviz": RVIZ,
    "worker_python": WORKER_PYTHON,
    **NODES,
}
"""Of ``simulator.launch.py``."""

DRIVE = {
    **SIMULATOR,
    "config": Argument(
        "", "YAML file of the world, its sensors and the drive; empty: the example rover_drive."
    ),
    "drive_json": Argument(
        "",
        "Keys of the configuration's section drive that replace the configured ones, as a JSON "
        "object.",
    ),
    "sensors": Argument(
        "", "Names of the sensors that measure, separated by commas; empty: all of them."
    ),
    "mapper": Argument("false", SIMULATOR["mapper"].description, SWITCH),
    "record": Argument(
        "true", "true records all topics of the namespace to a new bag_DATE; a path, to there."
    ),
    "recorder": Argument(
        "oaisys",
        "Program that records: this package's recorder, which the drive waits for, or ros2 bag "
        "record, which may begin after the drive; auto: ros2 bag record where it is installed.",
        ("oaisys", "ros2", "auto"),
    ),
}
"""Of ``drive.launch.py``."""

_EXPERIMENT = {
    "config": CONFIG,
    "backend": BACKEND,
    "seed": Argument("", "Root seed of the world; empty: as configured."),
    "size": Argument(
        "", "Size of the images, WIDTHxHEIGHT, for a quick run; empty: as configured."
    ),
    "quality": Argument(
        "",
        "Quality of colour: draft, preview, standard, high, final or geometry; empty: as "
        "configured.",
    ),
    "voxel_size": Argument("0.1", "Voxel size of the map, metres."),
    "key": Argument("", "PEM file of an Ed25519 key that signs the certificate; empty: none."),
    "namespace": NAMESPACE,
    "worker_python": WORKER_PYTHON,
    "record": Argument("true", "Whether to record all topics to a rosbag2 MCAP bag.", SWITCH),
    **NODES,
}
SURVEY = {
    "out": Argument("out/survey", "Folder for report, mesh, pictures and bag."),
    "views": Argument("30", "Number of viewpoints in the grid."),
    "altitude": Argument("10.0", "Height of the viewpoints above the ground, metres."),
    "overlap": Argument("0.35", "Overlap of neighbouring images, as a share of their edge."),
    "max_range": Argument("60.0", "Largest depth that is mapped, metres."),
    "seeds": Argument(
        "", "Number of worlds, or their seeds separated by commas; empty: one world."
    ),
    "faults": Argument("true", "Whether to evaluate maps with deliberate faults, too.", SWITCH),
    "light": Argument(
        "", "JSON file of `oaisys audit --light --out FILE` for the certificate; empty: none."
    ),
    **_EXPERIMENT,
}
"""Of ``survey.launch.py``, beside ``rviz``: each is an option of ``oaisys survey``."""

EXPLORE = {
    "out": Argument("out/explore", "Folder for report, mesh, pictures and bag."),
    "planner": Argument(
        "next_best_view",
        "next_best_view, frontier, grid, random, or an installed package's; all: these four.",
    ),
    "node": Argument(
        "", "NAME=COMMAND of a planner that is a program of its own, such as a ROS node."
    ),
    "node_silence": Argument(
        "60.0", "A node is done once it has commanded no view for so long, seconds."
    ),
    "plan_timeout": Argument(
        "120.0", "How long a planner of another package may take for a pose, seconds."
    ),
    "compare": Argument(
        "false", "Whether all other planners explore the same worlds, too.", SWITCH
    ),
    "seeds": Argument("1", "Number of worlds, or their seeds separated by commas."),
    "via": Argument(
        "service",
        "How views are requested: by the set_pose service, or on command/trajectory.",
        ("service", "trajectory"),
    ),
    "views": Argument("60", "Largest number of views of an exploration."),
    "baseline_views": Argument("400", "Largest number of views of every planner but the first."),
    "until": Argument(
        "",
        "Coverage at which an exploration ends; empty: 0.95, or 0.9 with several planners.",
    ),
    "path": Argument("20000.0", "Longest path, metres."),
    "planning_voxel": Argument("0.5", "Voxel size of the planner's map, metres."),
    "radius": Argument("1.0", "Radius of the vehicle, metres."),
    "camera_range": Argument("20.0", "Largest depth that is used, metres."),
    "start_height": Argument("3.0", "Height of the first view above the ground, metres."),
    **_EXPERIMENT,
}
"""Of ``explore.launch.py``, beside ``rviz``: each is an option of ``oaisys explore``."""

OPTIONS = {"record": "bag"}
"""Arguments whose command-line option has another name."""


def command_line(arguments: Mapping[str, Argument], values: Mapping[str, str]) -> list[str]:
    """Return the command-line options of an experiment, without defaults."""
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
    """Return the launch's ROS domain, for experiments, which would claim one of their own."""
    return {DOMAIN_VARIABLE: os.environ.get(DOMAIN_VARIABLE, "0")}
