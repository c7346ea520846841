"""Settings of all nodes of a launch or an experiment: parameters, log level, clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.files.documents import read_text
from oaisys_core.files.folders import user_path
from oaisys_core.files.yaml_documents import parse_yaml

LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
WILDCARDS = ("**", "*")
PARAMETERS = "ros__parameters"


@dataclass(frozen=True)
class NodeSettings:
    """Settings with which all nodes are started.

    Attributes:
        params_file: Parameters by node, as ROS reads them; None: none.
        log_level: One of `LOG_LEVELS`; empty: ROS's own.
        use_sim_time: Whether nodes follow ``/clock``; not the one that publishes it.
        named: The parameters that the file names, by the last part of its nodes' names.
    """

    params_file: Path | None = None
    log_level: str = ""
    use_sim_time: bool = False
    named: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def of_file(self, node: str) -> Mapping[str, Any]:
        """Return the parameters in the file for a node, given by its executable's name."""
        found: dict[str, Any] = {}
        for name in (*WILDCARDS, f"oaisys_{node}"):
            found |= self.named.get(name, {})
        return found

    def follows_clock(self, node: str) -> bool:
        """Return whether a node, given by its executable's name, follows ``/clock``."""
        is_clock = node == "bridge" and bool(self.of_file("bridge").get("publish_clock"))
        return self.use_sim_time and not is_clock

    def require_free(self, node: str, fixed: Iterable[str]) -> None:
        """Raise `InvalidInputError` if the file has a parameter that is set otherwise."""
        for name in fixed:
            if name in self.of_file(node):
                expected = f"a file without {name} of oaisys_{node}, which is set otherwise"
                raise InvalidInputError("params_file", str(self.params_file), expected)

    def ros_arguments(
        self, node: str, usual: Mapping[str, Any], fixed: Mapping[str, Any]
    ) -> list[str]:
        """Return the arguments of a node's process.

        Args:
            node: Its executable's name.
            usual: Parameters that the file may override.
            fixed: Parameters that it may not override.

        Raises:
            InvalidInputError: The file has a fixed one.
        """
        self.require_free(node, fixed)
        arguments = ["--ros-args"]
        if self.params_file is not None:
            arguments += ["--params-file", str(self.params_file)]
        # Not those in the file: which of two values wins depends on the order of its nodes.
        of_file = self.of_file(node)
        arguments += _assignments({k: v for k, v in usual.items() if k not in of_file})
        arguments += _assignments(fixed)
        if self.follows_clock(node):
            arguments += _assignments({"use_sim_time": True})
        if self.log_level:
            arguments += ["--log-level", self.log_level]
        return arguments


def node_settings(params_file: str, log_level: str, *, use_sim_time: bool) -> NodeSettings:
    """Return the settings; empty strings: ROS's own.

    Raises:
        InvalidInputError: There is no such file or level, or the file holds no parameters.
    """
    if log_level and log_level not in LOG_LEVELS:
        raise InvalidInputError("log_level", log_level, one_of(LOG_LEVELS, log_level))
    if not params_file:
        return NodeSettings(None, log_level, use_sim_time)
    file = user_path(params_file, "params_file").absolute()
    return NodeSettings(file, log_level, use_sim_time, _by_node(file))


def _assignments(parameters: Mapping[str, Any]) -> list[str]:
    return [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]


def _by_node(file: Path) -> Mapping[str, Mapping[str, Any]]:
    """Return the parameters in a file, by the last part of its nodes' names."""
    expected = f"a YAML file of parameters: NODE: {{{PARAMETERS}: {{NAME: VALUE}}}}"
    try:
        nodes = parse_yaml(read_text(file))
    except (OSError, ValueError):
        raise InvalidInputError("params_file", str(file), expected) from None
    if not isinstance(nodes, dict):
        raise InvalidInputError("params_file", str(file), expected)
    named: dict[str, dict[str, Any]] = {}
    for name, node in nodes.items():
        parameters = node.get(PARAMETERS) if isinstance(node, dict) else None
        if not isinstance(parameters, dict):
            raise InvalidInputError("params_file", str(file), expected)
        named.setdefault(str(name).rsplit("/", 1)[-1], {}).update(parameters)
    return named
