"""Reads robots, told apart by their root element."""

from __future__ import annotations

import re

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.robots.elements import FIELD, parse_xml
from oaisys_core.files.calibrations.robots.records import Robot
from oaisys_core.files.calibrations.robots.sdf import read_sdf
from oaisys_core.files.calibrations.robots.urdf import read_urdf

SUFFIXES = (".urdf", ".sdf", ".xacro", ".world")
_ROOT = re.compile(rb"<\s*(robot|sdf|gazebo)\b")


def is_robot(data: bytes, suffix: str) -> bool:
    """Return whether a file is a robot's, by its suffix or by the elements in it."""
    return suffix.lower() in SUFFIXES or (
        data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and _ROOT.search(data) is not None
    )


def read_robot(data: bytes, base: str | None = None, model: str | None = None) -> Robot:
    """Return the robot in a URDF or SDF file.

    Args:
        data: The content of the file.
        base: Link that becomes ``base_link``; None: the link of this name, or the root of URDF, or
            the model's frame of SDF.
        model: Which of the models of SDF; None for the only one.

    Raises:
        InvalidInputError: It is neither, a value is missing or wrong, or we lack a model.
    """
    root = parse_xml(data)
    if root.tag == "sdf":
        return read_sdf(root, base, model)
    if root.tag == "robot":
        if model is not None:
            raise InvalidInputError(f"{FIELD}.model", model, "no name: URDF has one robot")
        return read_urdf(root, base)
    expected = "<robot> (URDF) or <sdf>; `gz sdf -p FILE` converts other formats of Gazebo"
    raise InvalidInputError(f"{FIELD}: line {root.line}", f"<{root.tag}>", expected)
