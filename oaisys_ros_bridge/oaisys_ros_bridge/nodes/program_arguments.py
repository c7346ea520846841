"""The arguments of a node's program: its own options, then those of ROS."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rclpy.utilities import remove_ros_args

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.parameters.reference import NODES, DescribedNode
from oaisys_ros_bridge.parameters.table import ParameterRow
from oaisys_ros_bridge.private.argument_errors import argument_errors

_PLACE_IN_SOURCE = re.compile(r",? at /\S+:\d+")


@contextmanager
def check_ros_arguments(arguments: Sequence[str]) -> Iterator[None]:
    """Raise `InvalidInputError` where ROS cannot use the arguments that the block gives it."""
    try:
        yield
    except argument_errors() as error:
        lines = _PLACE_IN_SOURCE.sub("", str(error)).split("\n")
        reason = "; ".join(line.strip() for line in lines if line.strip())
        expected = f"what ROS can use, such as --ros-args -p NAME:=VALUE ({reason})"
        raise InvalidInputError("arguments", " ".join(arguments), expected) from error


def parse_arguments(
    parser: argparse.ArgumentParser, arguments: Sequence[str] | None
) -> tuple[argparse.Namespace, list[str]]:
    """Return a program's own options, and all its arguments for ROS, with the program's name.

    Exits with code 0 after ``--help``, and with 2 and a sentence for an argument that neither the
    program nor ROS knows.
    """
    given = list(sys.argv if arguments is None else arguments)
    try:
        with check_ros_arguments(given[1:]):
            own = remove_ros_args(given)[1:]
    except InvalidInputError as error:
        parser.error(str(error))
    return parser.parse_args(own), given


def node_parser(executable: str) -> argparse.ArgumentParser:
    """Return the parser of a node's program, whose help lists the node's parameters."""
    (node,) = (node for node in NODES if node.executable == executable)
    return program_parser(executable, node.about, node.example, _parameter_lines(node))


def program_parser(
    executable: str, about: str, example: str, lines: Sequence[str] = ()
) -> argparse.ArgumentParser:
    """Return a parser whose help ends with an example and, before it, with ``lines``."""
    command = f"python -P -m oaisys_ros_bridge.nodes.{executable}"
    return argparse.ArgumentParser(
        prog=command,
        usage=f"{command} [OPTIONS] [--ros-args ROS_ARGUMENTS]",
        description=about,
        epilog="\n".join([*lines, "example:", f"  {command} {example}"]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )


def _parameter_lines(node: DescribedNode) -> list[str]:
    lines = ["parameters, each set by --ros-args -p NAME:=VALUE:"]
    for row in node.parameters:
        lines += [f"  {row.name} (default {_show(row)})", f"      {row.description}"]
    return [*lines, ""]


def _show(row: ParameterRow) -> str:
    default = row.default
    return str(default).lower() if isinstance(default, bool) else repr(default)
