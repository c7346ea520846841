"""The parameters of our nodes: the only place where one is named, described and bounded."""

from __future__ import annotations

from oaisys_ros_bridge.parameter_table import Changeable, ParameterRow, ParameterTable

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
)

_COMMANDS = (
    ParameterRow(
        "trajectory_points",
        "every",
        "Which points of a trajectory on command/trajectory are rendered.",
        choices=("every", "last"),
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
)

_CLOUDS = (
    ParameterRow(
        "publish_points",
        True,
        "Whether to publish clouds.",
    ),
)

BRIDGE = ParameterTable((*_CONNECTION, *_LIFE, *_COMMANDS, *_FRAMES, *_CLOUDS))
