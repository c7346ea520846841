"""The reference page of the nodes, written from their tables of interfaces and parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from oaisys_ros_bridge.parameters.bags import PLAYER, RECORDER
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.parameters.bridge_interfaces import BRIDGE_INTERFACES
from oaisys_ros_bridge.parameters.interface_table import (
    MAPPER_INTERFACES,
    RECORDER_INTERFACES,
    Interface,
    InterfaceKind,
)
from oaisys_ros_bridge.parameters.mapper import MAPPER
from oaisys_ros_bridge.parameters.table import ParameterRow, ParameterTable

PROSE = Path(__file__).with_name("reference.md")
"""The text before the tables."""

HEADINGS = {
    InterfaceKind.SERVICE: "Services",
    InterfaceKind.ACTION: "Actions",
    InterfaceKind.SUBSCRIBED: "Subscriptions",
    InterfaceKind.PUBLISHED: "Topics",
}


@dataclass(frozen=True)
class DescribedNode:
    """One node on the page.

    Attributes:
        executable: For ``ros2 run oaisys_ros_bridge``.
        about: One sentence.
        example: Arguments of its program, which its help shows.
    """

    name: str
    executable: str
    about: str
    example: str
    interfaces: Sequence[Interface]
    parameters: ParameterTable


NODES = (
    DescribedNode(
        "oaisys_bridge",
        "bridge",
        "A managed node: pose requests in, samples out. Configured, it knows the simulator; "
        "active, it renders. It gets there by itself, and again when the simulator is back.",
        "--ros-args -p address:=127.0.0.1:50051 -r __ns:=/mars",
        BRIDGE_INTERFACES,
        BRIDGE,
    ),
    DescribedNode(
        "oaisys_mapper",
        "mapper",
        "Rebuilds the surface from depth, cameras and poses.",
        "--ros-args -p voxel_size:=0.05 -r camera/depth/image_raw:=front/depth",
        MAPPER_INTERFACES,
        MAPPER,
    ),
    DescribedNode(
        "oaisys_recorder",
        "recorder",
        "Records topics as a rosbag2 MCAP, every message written through; `oaisys record`.",
        "--out bag --topics /camera/color/image_raw --all --ros-args -p duration_s:=60.0",
        RECORDER_INTERFACES,
        RECORDER,
    ),
    DescribedNode(
        "oaisys_player",
        "player",
        "Publishes a bag again, with its qualities of service; `oaisys bag replay`. Its topics "
        "are the bag's, and `/clock` on request.",
        "--ros-args -p path:=bag -p clock_hz:=100.0 -r camera/color/image_raw:=image",
        (),
        PLAYER,
    ),
)


def reference_text() -> str:
    """Return the whole page, as Markdown."""
    lines = [PROSE.read_text(encoding="utf-8").rstrip(), ""]
    for node in NODES:
        lines += _node_lines(node)
    return "\n".join(lines).rstrip() + "\n"


def _node_lines(node: DescribedNode) -> Iterator[str]:
    yield from (f"## Node `{node.name}`", "")
    yield from (f"`ros2 run oaisys_ros_bridge {node.executable}`. {node.about}", "")
    for kind, heading in HEADINGS.items():
        rows = [row for row in node.interfaces if row.kind is kind]
        if not rows:
            continue
        is_topic = kind in {InterfaceKind.SUBSCRIBED, InterfaceKind.PUBLISHED}
        yield from (f"### {heading}", "")
        yield (
            "| name | type | what | quality of service |" if is_topic else "| name | type | what |"
        )
        yield "|---|---|---|" + ("---|" if is_topic else "")
        for row in rows:
            qos = f" {row.qos} |" if is_topic else ""
            yield f"| `{row.name}` | `{row.type_name}` | {row.description} |{qos}"
        yield ""
    yield from ("### Parameters", "")
    yield "| name | type | unit | default | what | may be | can be set |"
    yield "|---|---|---|---|---|---|---|"
    for parameter in node.parameters:
        yield _parameter_line(parameter)
    yield ""


def _parameter_line(row: ParameterRow) -> str:
    default = str(row.default).lower() if isinstance(row.default, bool) else repr(row.default)
    cells = (
        f"`{row.name}`",
        row.type_name,
        row.unit,
        f"`{default}`",
        row.description,
        row.expectation,
        row.changeable.value,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
