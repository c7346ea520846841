"""Robots in URDF and SDF files: where their sensors are, how they measure, and their shapes."""

from oaisys_core.files.calibrations.robots.reading import is_robot, read_robot
from oaisys_core.files.calibrations.robots.records import Robot, Shape, Visual

__all__ = ["Robot", "Shape", "Visual", "is_robot", "read_robot"]
