"""Cameras of calibrations on the links of robots whose files do not say how they measure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.files.calibrations import read_calibration
from oaisys_core.files.calibrations.robots import Robot
from oaisys_core.geometry import T_LINK_OPTICAL

FIELD = "camera"
OPTICAL = "optical"


def put_camera(robot: Robot, link: str, file: Path) -> Robot:
    """Return a robot that has the camera of a calibration on one of its links.

    The camera looks along x of the link; where the link's name has ``optical`` in it, along z, with
    y down (REP-103). It replaces a camera of the robot that has its name.

    Args:
        robot: It.
        link: Name of the link.
        file: Calibration of one camera, of any format of `read_calibration`.

    Raises:
        InvalidInputError: The robot has no such link, or the calibration cannot be read or has not
            exactly one camera.
    """
    if link not in robot.T_base_links:
        raise InvalidInputError(FIELD, link, one_of(list(robot.T_base_links), link))
    found = read_calibration(file)
    if len(found.cameras) != 1:
        expected = "a calibration of one camera"
        raise InvalidInputError(FIELD, f"{file}, with {len(found.cameras)} cameras", expected)
    is_optical = OPTICAL in link.lower()
    T_base_link = robot.T_base_links[link]
    T_base_optical = T_base_link if is_optical else T_base_link @ T_LINK_OPTICAL
    camera = replace(found.cameras[0], T_base_optical=T_base_optical)
    others = tuple(each for each in robot.sensors.cameras if each.name != camera.name)
    replaced = ", replaces the robot's" if len(others) < len(robot.sensors.cameras) else ""
    note = (
        f"camera {camera.name} has the calibration {file.name} ({found.format}){replaced}, and"
        f" looks along {'z' if is_optical else 'x'} of {link}"
    )
    notes = (*robot.sensors.notes, *found.comments(), note)
    sensors = replace(robot.sensors, cameras=(*others, camera), notes=notes)
    return replace(robot, sensors=sensors)
