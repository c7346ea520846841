"""Poses in URDF and SDF, and SDF's frames that refer to each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.robots.elements import XmlElement
from oaisys_core.geometry import check_pose, pose_to_matrix, transform
from oaisys_core.types import FloatArray

MODEL = "__model__"


def rotation_of(roll_pitch_yaw_rad: list[float]) -> FloatArray:
    """Return the (3, 3) rotation of angles about fixed x, y and z, in this order."""
    if not any(roll_pitch_yaw_rad):  # most of them; SciPy takes longer
        return np.eye(3)
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", roll_pitch_yaw_rad).as_matrix())


def origin_in(element: XmlElement) -> FloatArray:
    """Return the (4, 4) pose in an element's ``<origin>`` of URDF; the identity without one.

    Raises:
        InvalidInputError: It has other attributes than positions and angles, or no numbers in them.
    """
    origin = element.child("origin")
    if origin is None:
        return np.eye(4)
    origin.check_attributes("xyz", "rpy")
    position = origin.numbers(3, text=origin.attributes.get("xyz") or "0 0 0")
    angles = origin.numbers(3, text=origin.attributes.get("rpy") or "0 0 0")
    return transform(rotation_of(angles), position)


def pose_of(pose: XmlElement | None) -> FloatArray:
    """Return the (4, 4) pose in a ``<pose>`` of SDF; the identity without one.

    Raises:
        InvalidInputError: It is not six numbers, or seven with a quaternion, or has attributes
            that SDF does not have.
    """
    if pose is None:
        return np.eye(4)
    pose.check_attributes("relative_to", "rotation_format", "degrees", "frame")
    if not pose.text:
        return np.eye(4)
    if pose.attributes.get("frame"):
        expected = "relative_to (SDF 1.7 on); `gz sdf -p FILE` converts it"
        raise InvalidInputError(pose.where, f'frame="{pose.attributes["frame"]}"', expected)
    kind = pose.attributes.get("rotation_format", "euler_rpy")
    if kind == "quat_xyzw":
        values = pose.numbers(7)
        return pose_to_matrix(check_pose(values[:3], values[3:], pose.where))
    if kind != "euler_rpy":
        raise InvalidInputError(pose.where, kind, "euler_rpy or quat_xyzw as rotation_format")
    values = pose.numbers(6)
    if pose.attributes.get("degrees", "false") in ("true", "1"):
        values[3:] = np.radians(values[3:]).tolist()
    return transform(rotation_of(values[3:]), values[:3])


def pose_in(element: XmlElement) -> FloatArray:
    """Return the pose in the ``<pose>`` of an element, relative to what contains it.

    Raises:
        InvalidInputError: It is relative to a frame with a name.
    """
    pose = element.child("pose")
    if pose is not None and pose.attributes.get("relative_to"):
        shown = f'relative_to="{pose.attributes["relative_to"]}"'
        raise InvalidInputError(pose.where, shown, "a pose relative to what contains it")
    return pose_of(pose)


@dataclass(frozen=True)
class NamedFrame:
    """A frame: its pose relative to another one, and where it stands in the file."""

    relative_to: str
    T: FloatArray
    where: str


class FrameGraph:
    """SDF's frames of a model by name: links, joints, ``<frame>`` and nested models.

    Names in a nested model begin with its name and ``::``.
    """

    def __init__(self) -> None:
        self._frames: dict[str, NamedFrame] = {}
        self._found: dict[str, FloatArray] = {MODEL: np.eye(4)}

    def add(self, name: str, relative_to: str, T: FloatArray, where: str) -> None:
        """Add a frame.

        Raises:
            InvalidInputError: Its name is taken.
        """
        if name in self._frames or name == MODEL:
            raise InvalidInputError(where, name, "a name that no other link, joint or frame has")
        self._frames[name] = NamedFrame(relative_to, T, where)

    def pose(self, name: str, where: str) -> FloatArray:
        """Return the (4, 4) pose of a frame in the model.

        Raises:
            InvalidInputError: There is no such frame, or it is relative to itself.
        """
        way: dict[str, None] = {}
        while name not in self._found:
            if name in way:
                raise InvalidInputError(where, " > ".join([*way, name]), "frames without a circle")
            if name not in self._frames:
                expected = f"one of {', '.join(self._frames)}"[:300]
                raise InvalidInputError(where, name, expected)
            way[name] = None
            where = self._frames[name].where
            name = self._frames[name].relative_to
        first = next(iter(way), name)
        for each in reversed(way):
            frame = self._frames[each]
            self._found[each] = self._found[frame.relative_to] @ frame.T
        return self._found[first]

    def poses(self) -> Iterator[tuple[str, FloatArray]]:
        """Yield the name and the (4, 4) pose in the model of each frame."""
        for name, frame in self._frames.items():
            yield name, self.pose(name, frame.where)
