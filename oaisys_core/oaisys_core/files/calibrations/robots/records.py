"""What a robot's file says, in the conventions of our configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from oaisys_core.files.calibrations.records import Calibration
from oaisys_core.types import FloatArray

RIGID_JOINTS = ("fixed",)


@dataclass(frozen=True)
class Shape:
    """The form of a visual.

    Attributes:
        kind: A primitive about its centre, whose cylinder and capsule are along z, or a mesh.
        size_m: Edge lengths of a box; radius and length of a cylinder and a capsule (without its
            ends); radius of a sphere; half axes of an ellipsoid; factors on the units of a mesh.
        uri: The file of a mesh, as the robot's file names it.
        object_name: The object in the mesh's file; None for all.
    """

    kind: Literal["box", "cylinder", "sphere", "capsule", "ellipsoid", "mesh"]
    size_m: tuple[float, ...]
    uri: str = ""
    object_name: str | None = None


@dataclass(frozen=True)
class Visual:
    """A shape of a robot as it is seen.

    Attributes:
        where: Its place in the file, for errors.
        shape: Its form.
        T_base_visual: (4, 4) pose on the robot.
        color_srgb: Its colour, 0 to 1; None if the file says none.
    """

    where: str
    shape: Shape
    T_base_visual: FloatArray
    color_srgb: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Robot:
    """A robot.

    Attributes:
        name: Its name in the file.
        sensors: What it measures with, and notes on what was assumed and what is not used.
        visuals: How it looks.
        visual_notes: Which visuals are not used, and why.
        sensor_links: Links that may hold sensors, by their names alone.
        T_base_links: By the name of each link its (4, 4) pose on the rig, joints at zero.
    """

    name: str
    sensors: Calibration
    visuals: tuple[Visual, ...] = ()
    visual_notes: tuple[str, ...] = ()
    sensor_links: tuple[str, ...] = ()
    T_base_links: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class Joint:
    """A joint; ``kind`` is that of its format, such as ``fixed`` or ``revolute``."""

    name: str
    kind: str
    parent: str
    child: str


@dataclass
class Notes:
    """What was assumed of a robot, each once, in the order in which it was found."""

    lines: dict[str, None] = field(default_factory=dict)

    def add(self, text: str) -> None:
        """Add a line unless it is there."""
        self.lines.setdefault(text)


def carrying_joints(joints: Sequence[Joint], links: Mapping[str, str]) -> dict[str, list[str]]:
    """Return what is carried by each movable joint, by the joint's kind and name.

    Args:
        joints: Those of the robot.
        links: By the name of what is carried the link that it is on.
    """
    by_child = {joint.child: joint for joint in joints}
    carried: dict[str, list[str]] = {}
    for name, first in links.items():
        seen: set[str] = set()
        link = first
        while link in by_child and link not in seen:
            seen.add(link)
            joint = by_child[link]
            if joint.kind not in RIGID_JOINTS:
                carried.setdefault(f"{joint.kind} joint {joint.name}", []).append(name)
            link = joint.parent
    return carried


def note_joints(
    joints: Sequence[Joint], sensors: Mapping[str, str], notes: Notes, shapes: Notes
) -> None:
    """Note which joints stand at zero under sensors, and which under anything that is seen.

    Args:
        joints: Those of the robot.
        sensors: By the name of a sensor the link that it is on.
        notes: About sensors.
        shapes: About visuals.
    """
    for joint, names in carrying_joints(joints, sensors).items():
        notes.add(f"{', '.join(names)}: the {joint} stands at zero")
    movable = [joint.name for joint in joints if joint.kind not in RIGID_JOINTS]
    if movable:
        shapes.add(f"at zero are the joints {', '.join(movable)}")


SENSOR_WORDS = ("camera", "cam", "optical", "lidar", "laser", "velodyne", "imu", "scan", "depth")


def links_like_sensors(names: Sequence[str]) -> tuple[str, ...]:
    """Return the links whose names sound as if sensors were there."""
    return tuple(name for name in names if any(word in name.lower() for word in SENSOR_WORDS))
