"""The parameters of the bridge: names, descriptions, defaults and ranges, each stated only here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.parameters.ground_maps import ground_map_rows
from oaisys_ros_bridge.parameters.publishing import CLOUDS, COMPRESSED, FAULTS, TRAJECTORY
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow, ParameterTable, Rule

LONGEST_TIMEOUT_S = 86_400.0
_ADDRESS = r"(unix:.+|\[[0-9a-fA-F:.]+\]:\d{1,5}|[^\s:/]+:\d{1,5})"
_FRAME = r"[^\s/][^\s]*"
_PEM = "path of a PEM file, or empty"

_CONNECTION = (
    ParameterRow(
        "address",
        "127.0.0.1:50051",
        "Where the simulator serves gRPC.",
        pattern=_ADDRESS,
        expects="host:port or unix:PATH",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "timeout_s",
        600.0,
        "Longest time that a call to the simulator may take, including queue and render.",
        unit="s",
        least=0.1,
        most=LONGEST_TIMEOUT_S,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "tls_ca",
        "",
        "Certificate authorities of a simulator that encrypts.",
        expects=_PEM,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "tls_cert",
        "",
        "The bridge's own certificate, if the simulator requires one.",
        expects=_PEM,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "tls_key",
        "",
        "Key of the bridge's own certificate.",
        expects=_PEM,
        changeable=Changeable.UNCONFIGURED,
    ),
)

_LIFE = (
    ParameterRow(
        "autostart",
        True,
        "Whether the bridge configures and activates itself; false: a lifecycle manager does.",
        changeable=Changeable.AT_START,
    ),
    ParameterRow(
        "initial_batch",
        True,
        "Whether to build a first batch if the simulator has none.",
    ),
    ParameterRow(
        "simulation_interfaces",
        True,
        "Whether to offer the services of simulation_interfaces.",
        changeable=Changeable.AT_START,
    ),
    ParameterRow(
        "max_entities",
        1000,
        "Most objects on the ground that get_entities and get_entities_states list; they report "
        "how many were left out.",
        least=1,
        most=100_000,
    ),
)

_COMMANDS = (
    ParameterRow(
        "trajectory_points",
        "every",
        "Which points of a trajectory on command/trajectory are rendered.",
        choices=("every", "last"),
    ),
)

_READERS = (
    ParameterRow(
        "readers.when_behind",
        "wait",
        "What happens to a sample while the mapper or a recorder is 4 behind: it waits until they "
        "have caught up, or it is rendered and they drop messages, which are counted.",
        choices=("wait", "drop"),
    ),
    ParameterRow(
        "readers.timeout_s",
        10.0,
        "A reader that takes no sample for this long is not waited for until it takes one again.",
        unit="s",
        least=0.0,
        most=3600.0,
    ),
)

_FRAMES = (
    ParameterRow(
        "map_frame",
        "map",
        "Frame of the world, in which poses are given and published.",
        pattern=_FRAME,
        expects="name of a frame, without a slash in front",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "base_frame",
        "base_link",
        "Frame of the rig.",
        pattern=_FRAME,
        expects="name of a frame, without a slash in front",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "odom_frame",
        "odom",
        "Frame of odometry that drifts, between map_frame and base_frame.",
        pattern=_FRAME,
        expects="name of a frame, without a slash in front",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "earth_frame",
        "earth",
        "Frame at Earth's centre (REP-105), above map_frame on a stage from an elevation model "
        "that lies on Earth; empty: none.",
        pattern=r"([^\s/][^\s]*)?",
        expects="name of a frame, without a slash in front, or empty",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "magnetic_year",
        2026.0,
        "Year of Earth's magnetic field, with its fraction (World Magnetic Model 2025).",
        least=2025.0,
        most=2030.0,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "tf_rate",
        10.0,
        "How often the rig's last transform and odometry are repeated for late subscribers; 0: "
        "never. While simulated time stands still: how often new subscribers are looked for, who "
        "then get them.",
        unit="Hz",
        least=0.0,
        most=1000.0,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "frame_prefix",
        "",
        "Prefix of the names of the cameras' frames; other frames have their own parameters.",
        pattern=r"([^\s/][^\s]*)?",
        expects="such as robot1/, without a slash in front, or empty",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "stereo.right_frame",
        "left",
        "Frame of the images and camera_info of a stereo pair's right camera: left is the left "
        "camera's optical frame, with P[3] = -fx baseline, as stereo_image_proc expects; own is "
        "its own, with P[3] = 0. Depth, range and clouds are always in its own.",
        choices=("left", "own"),
        changeable=Changeable.UNCONFIGURED,
    ),
)

_CLOCK = (
    ParameterRow(
        "publish_clock",
        False,
        "Whether this node publishes a simulated time on /clock, which stamps then follow; false: "
        "stamps are from the node's own clock.",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "clock_step_s",
        0.1,
        "How much simulated time increases with each sample.",
        unit="s",
        least=1e-9,
        most=LONGEST_TIMEOUT_S,
    ),
)


def _below(least: str, most: str) -> Rule:
    """Return the rule that one limit is below the other, if there is another."""

    def check(values: Mapping[str, Any]) -> None:
        if 0 < values[most] <= values[least]:
            expected = f"more than {least}, which is {values[least]:g} m, or 0"
            raise InvalidInputError(most, values[most], expected)

    return check


BRIDGE = ParameterTable(
    (
        *_CONNECTION,
        *_LIFE,
        *_COMMANDS,
        *_READERS,
        *_FRAMES,
        *CLOUDS,
        *COMPRESSED,
        *TRAJECTORY,
        *_CLOCK,
        *ground_map_rows(length_m=0.0, period_s=0.0),
        *FAULTS,
    ),
    rules=(
        _below("cloud.min_depth_m", "cloud.max_depth_m"),
        _below("faults.min_depth_m", "faults.max_depth_m"),
    ),
)
