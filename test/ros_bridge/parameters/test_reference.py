"""The reference page against what running nodes say of themselves."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from rcl_interfaces.srv import ListParameters
from repository import REPOSITORY
from ros_peer import Stage
from served_simulator import FLAT_WORLD

from oaisys_ros_bridge.parameters.interface_table import InterfaceKind
from oaisys_ros_bridge.parameters.reference import NODES, DescribedNode, reference_text

PAGE = REPOSITORY / "docs" / "ros.md"
CONFIG = REPOSITORY / "config"
TOPIC = re.compile(r'"(/[a-z_0-9/A-Z]+)"')
PANEL = re.compile(r'"([A-Za-z0-9]+![a-z_]+)"')
RUNNING = [node for node in NODES if node.interfaces]
EVERY_NODES = {"/parameter_events", "/rosout"}
PARAMETER_SERVICES = {
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
}
ROS_OWN = {"use_sim_time", "start_type_description_service"}
Names = set[tuple[str, str]]


@pytest.fixture
def stage(tmp_path: Path, ros_domain_id: int, no_process_left: None) -> Iterator[Stage]:
    with Stage(tmp_path) as stage:
        scan = {"kind": "rotating", "preset": "generic_16", "azimuth_steps": 90}
        sensors = FLAT_WORLD["sensors"] | {
            "lidars": [{"name": "lidar", "scan": scan}],
            "imus": [{"name": "imu"}],
        }
        address = stage.start_world(FLAT_WORLD | {"sensors": sensors}).address
        parameters = ("-p", f"address:={address}", "-p", "publish_clock:=true")
        stage.start_node("bridge", "--ros-args", *parameters)
        stage.start_node("mapper")
        stage.start_node("recorder", "--out", str(tmp_path / "bag"))
        stage.user.wait_until_ready()
        yield stage


def test_the_page_is_what_the_tables_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference_text(), "run `make schema`"


def test_the_readme_counts_the_services_that_there_are() -> None:
    rows = [row for node in NODES for row in node.interfaces if row.kind is InterfaceKind.SERVICE]
    offered = [row for row in rows if row.type_name.startswith("simulation_interfaces/")]
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    counted = re.findall(r"(\d+) services of `simulation_interfaces`", readme)
    assert counted == [str(len(offered))]


def described(node: DescribedNode, kind: InterfaceKind) -> Names:
    """Return full names and types of the table, for a camera with one semantic level."""
    found = set()
    for row in node.interfaces:
        if row.kind is kind:
            name = row.name.replace("~", node.name).replace("semantic_N", "semantic_0")
            found.add((f"/{name.removeprefix('/')}", row.type_name))
    return found


def offered(stage: Stage, node: DescribedNode, kind: InterfaceKind) -> Names:
    """Return full names and types in the graph, what all nodes have apart."""
    graph = stage.user.node
    if kind is InterfaceKind.ACTION:
        services = graph.get_service_names_and_types_by_node(node.name, "/")
        end = "/_action/send_goal"
        return {
            (name.removesuffix(end), types[0].removesuffix("_SendGoal"))
            for name, types in services
            if name.endswith(end)
        }
    if kind is InterfaceKind.SERVICE:
        rows = graph.get_service_names_and_types_by_node(node.name, "/")
        rows = [row for row in rows if row[0].split("/")[-1] not in PARAMETER_SERVICES]
    elif kind is InterfaceKind.PUBLISHED:
        rows = graph.get_publisher_names_and_types_by_node(node.name, "/")
    else:
        rows = graph.get_subscriber_names_and_types_by_node(node.name, "/")
    return {
        (name, types[0])
        for name, types in rows
        if name not in EVERY_NODES and "/_action/" not in name
    }


@pytest.mark.long
@pytest.mark.ros
def test_all_names_and_types_and_parameters_are_on_the_page(stage: Stage) -> None:
    for node in RUNNING:
        compare(stage, node)


def compare(stage: Stage, node: DescribedNode) -> None:
    user = stage.user
    user.wait_until(lambda: node.name in user.node.get_node_names())
    for kind in InterfaceKind:
        if node.name == "oaisys_recorder" and kind is InterfaceKind.SUBSCRIBED:
            continue  # whatever there is
        wait_for(stage, node, kind)
        assert offered(stage, node, kind) == described(node, kind), (node.name, kind)
    client = user.client(ListParameters, f"{node.name}/list_parameters")
    answer = user.answer(client.call_async(ListParameters.Request()))
    declared = {n for n in answer.result.names if not n.startswith("qos_overrides")} - ROS_OWN
    assert declared == {row.name for row in node.parameters}, node.name


def wait_for(stage: Stage, node: DescribedNode, kind: InterfaceKind) -> None:
    """Wait until discovery has told of all that the page has."""
    expected = described(node, kind)
    stage.user.wait_until(lambda: expected <= offered(stage, node, kind))


def test_what_viewers_show_exists() -> None:
    topics = {
        f"/{row.name.replace('~', node.name).replace('semantic_N', 'semantic_0').lstrip('/')}"
        for node in NODES
        for row in node.interfaces
        if row.kind is InterfaceKind.PUBLISHED
    }
    rviz = yaml.safe_load((CONFIG / "simulator.rviz").read_text())
    displays = rviz["Visualization Manager"]["Displays"]
    shown = {display["Topic"]["Value"] for display in displays if "Topic" in display}
    foxglove = json.loads((CONFIG / "foxglove.json").read_text())
    drawn = set(TOPIC.findall(json.dumps(foxglove)))
    panels = set(foxglove["configById"])

    assert len(shown) >= 10
    assert shown <= topics
    assert shown - {"/oaisys_mapper/mesh"} <= drawn <= topics
    assert panels == set(PANEL.findall(json.dumps(foxglove["layout"])))
