"""The parameters of our nodes: the only place where one is named, described and bounded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow, ParameterTable, Rule

LONGEST_TIMEOUT_S = 86_400.0
FARTHEST_M = 1e6
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
        "Longest time that a call to the simulator may take, queue and render included.",
        unit="s",
        least=0.1,
        most=LONGEST_TIMEOUT_S,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "tls_ca",
        "",
        "Authorities of the certificate of a simulator that encrypts.",
        expects=_PEM,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "tls_cert",
        "",
        "The bridge's own certificate, where the simulator asks for one.",
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
        "Whether the bridge configures and activates itself; false: somebody else does.",
        changeable=Changeable.AT_START,
    ),
    ParameterRow(
        "initial_batch",
        True,
        "Whether to build a first batch where the simulator has none.",
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
        "Most things on the ground that get_entities and get_entities_states list; they say how "
        "many were left out.",
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
        "What a sample does while the mapper or a recorder is 4 behind: wait until they have taken "
        "what they lack, or drop what they then lose, which is counted all the same.",
        choices=("wait", "drop"),
    ),
    ParameterRow(
        "readers.timeout_s",
        10.0,
        "Who has taken no sample for so long is not waited for again until it does.",
        unit="s",
        least=0.0,
        most=3600.0,
    ),
)

_FRAMES = (
    ParameterRow(
        "map_frame",
        "map",
        "Frame of the world, in which poses come and go.",
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
        "Frame of odometry where it drifts: between map_frame and base_frame.",
        pattern=_FRAME,
        expects="name of a frame, without a slash in front",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "tf_rate",
        10.0,
        "How often the rig's last transform is repeated on /tf, for those who come later; 0: "
        "never. Not while simulated time stands still.",
        unit="Hz",
        least=0.0,
        most=1000.0,
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "frame_prefix",
        "",
        "Put before the names of the cameras' frames; the other frames are given whole.",
        pattern=r"([^\s/][^\s]*)?",
        expects="such as robot1/, without a slash in front, or empty",
        changeable=Changeable.UNCONFIGURED,
    ),
)

_CLOUDS = (
    ParameterRow(
        "publish_points",
        True,
        "Whether to publish clouds.",
    ),
    ParameterRow(
        "cloud.stride",
        1,
        "Only every so many columns and rows of the depth image become points.",
        unit="px",
        least=1,
        most=64,
    ),
    ParameterRow(
        "cloud.min_depth_m",
        0.0,
        "What is nearer, along the optical axis, becomes no point.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "cloud.max_depth_m",
        0.0,
        "What is farther, along the optical axis, becomes no point; 0: no limit.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "cloud.drop_sky",
        False,
        "Whether a cloud is one row of the points that there are; false: organised as the image, "
        "NaN where there is none.",
    ),
)

_COMPRESSED = (
    ParameterRow(
        "compressed.color_format",
        "jpeg",
        "Of colour on .../compressed; labels and ids are always PNG, which loses nothing.",
        choices=("jpeg", "png"),
    ),
    ParameterRow(
        "compressed.jpeg_quality",
        95,
        "Of JPEG.",
        least=1,
        most=100,
    ),
    ParameterRow(
        "compressed.png_level",
        1,
        "Of PNG: 0 is fast, 9 is small.",
        least=0,
        most=9,
    ),
    ParameterRow(
        "compressed.depth_encoding",
        "32FC1",
        "Of depth on .../compressedDepth: 32FC1 rounds the inverse of depth to 16 bits, 16UC1 "
        "depth to millimetres.",
        choices=("32FC1", "16UC1"),
    ),
    ParameterRow(
        "compressed.depth_max_m",
        100.0,
        "Depth beyond it is sent compressed as no measurement.",
        unit="m",
        least=0.1,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "compressed.depth_quantization",
        100.0,
        "How finely 32FC1 is rounded, by z^2 / (2 q^2) metres at most; nearer than q^2 / 65535 "
        "metres it tells nothing.",
        least=1.0,
        most=10_000.0,
    ),
)

_TRACES = (
    ParameterRow(
        "path.length",
        1000,
        "Poses that path holds; the oldest go first. 0: no path.",
        least=0,
        most=100_000,
    ),
    ParameterRow(
        "viewpoints.count",
        1000,
        "Frusta that viewpoints shows; the oldest go first. 0: none.",
        least=0,
        most=100_000,
    ),
    ParameterRow(
        "viewpoints.depth_m",
        0.5,
        "How deep a frustum is drawn.",
        unit="m",
        least=0.001,
        most=1000.0,
    ),
)

_CLOCK = (
    ParameterRow(
        "publish_clock",
        False,
        "Whether this node tells a simulated time on /clock, which stamps then follow; false: "
        "stamps are of the node's own clock.",
        changeable=Changeable.UNCONFIGURED,
    ),
    ParameterRow(
        "clock_step_s",
        0.1,
        "How far simulated time goes on with each sample.",
        unit="s",
        least=1e-9,
        most=LONGEST_TIMEOUT_S,
    ),
)

_FAULTS = (
    ParameterRow(
        "faults.seed",
        0,
        "Root of all draws of faults: the same seed, batch, sample and sensor, the same faults.",
        least=0,
        most=2**63 - 1,
    ),
    ParameterRow(
        "faults.depth_noise",
        "none",
        "Law of the error of a depth z: gaussian has a standard deviation of depth_sigma_m, "
        "quadratic of depth_sigma_m + depth_sigma_per_m z^2, kinect that of structured light.",
        choices=("none", "gaussian", "quadratic", "kinect"),
    ),
    ParameterRow(
        "faults.depth_sigma_m",
        0.01,
        "See faults.depth_noise.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "faults.depth_sigma_per_m",
        0.001,
        "See faults.depth_noise.",
        unit="1/m",
        least=0.0,
        most=1000.0,
    ),
    ParameterRow(
        "faults.min_depth_m",
        0.0,
        "What is measured nearer is published as -inf.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "faults.max_depth_m",
        0.0,
        "What is measured farther is published as +inf; 0: no limit.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "faults.missing_ratio",
        0.0,
        "Share of depth pixels that are published as NaN.",
        least=0.0,
        most=1.0,
    ),
    ParameterRow(
        "faults.drift_m",
        0.0,
        "Standard deviation of what odometry drifts along each axis with every sample.",
        unit="m",
        least=0.0,
        most=1000.0,
    ),
    ParameterRow(
        "faults.drift_rad",
        0.0,
        "Standard deviation of what odometry turns about each axis with every sample.",
        unit="rad",
        least=0.0,
        most=3.2,
    ),
    ParameterRow(
        "faults.tf_drifts",
        False,
        "Whether the transform of the rig is that of odometry; false: it is the true one.",
    ),
)


def _ordered(least: str, most: str) -> Rule:
    """Return the rule that one limit is below the other, where there is another."""

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
        *_CLOUDS,
        *_COMPRESSED,
        *_TRACES,
        *_CLOCK,
        *_FAULTS,
    ),
    rules=(
        _ordered("cloud.min_depth_m", "cloud.max_depth_m"),
        _ordered("faults.min_depth_m", "faults.max_depth_m"),
    ),
)
