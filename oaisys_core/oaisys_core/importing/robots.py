"""Configurations of robots: the rig's sensors, and the robot's shape as a mover."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations import Calibration
from oaisys_core.files.calibrations.robots import Robot
from oaisys_core.importing.robot_mesh import robot_mesh
from oaisys_core.procedural.meshes.gltf_format.gltf_writer import write_glb

LABEL, SEMANTIC_ID = "robot", 60
WAY_M, STEP_M = ((4.0, 0.0), (12.0, 0.0)), 0.25


def sensors_section(found: Calibration) -> dict[str, Any]:
    """Return the section `sensors` with the sensors of a calibration or of a robot.

    Raises:
        InvalidInputError: A camera has no image size.
    """
    for camera in found.cameras:
        if camera.size_px is None:
            expected = "a size; write it into the file, such as image_width and image_height"
            raise InvalidInputError(f"calibration.{camera.name}", "no image size", expected)
    sensors: dict[str, Any] = {}
    if found.cameras:
        sensors["cameras"] = [{"name": each.name, **each.config()} for each in found.cameras]
    for key, each_kind in (("lidars", found.lidars), ("imus", found.imus)):
        if each_kind:
            sensors[key] = [dict(each) for each in each_kind]
    if found.faults:
        sensors["faults"] = dict(found.faults)
    return sensors


def robot_sections(
    robot: Robot, file: Path, out: Path | None, packages: Sequence[Path] = ()
) -> tuple[dict[str, Any], list[str]]:
    """Return the sections of a robot's configuration, and notes; its mesh is written beside it.

    Args:
        robot: It.
        file: Its file.
        out: The configuration that will be written; None: no mesh is written.
        packages: Folders that are packages or models, or contain them.

    Raises:
        InvalidInputError: The robot has neither sensors nor, with ``out``, visuals that can be
            shown, or its mesh cannot be written.
    """
    sensors = sensors_section(robot.sensors)
    notes = list(robot.sensors.notes)
    if sensors and not robot.sensors.cameras:
        notes.append("it has no camera; the default one is at base_link")
    if not sensors:
        notes.append(_no_sensors(robot))
    sections: dict[str, Any] = {"sensors": sensors} if sensors else {}
    if out is None:
        if robot.visuals:
            notes.append(f"its {len(robot.visuals)} visuals become a mover with --out FILE")
    else:
        mover, more = _mover(robot, file, out, packages)
        notes += [*robot.visual_notes, *more]
        sections |= {"assets": {"movers": [mover]}} if mover else {}
    if not sections:
        raise InvalidInputError("robot", f"{robot.name} without sensors", "; ".join(notes[1:]))
    return sections, notes


def _no_sensors(robot: Robot) -> str:
    """Return what to do about a robot without sensors; names of links are no sensors."""
    said = "it has no camera, lidar or IMU; in URDF they are <gazebo reference=LINK><sensor>"
    if robot.sensor_links:
        links = ", ".join(robot.sensor_links)[:300]
        said += (
            f". By their names, links that may hold sensors are {links};"
            " --camera LINK=FILE puts the camera of a calibration there"
        )
    return said


def _mover(
    robot: Robot, file: Path, out: Path, packages: Sequence[Path]
) -> tuple[dict[str, Any], list[str]]:
    """Return the mover with the visuals of a robot, whose mesh is written; empty without any."""
    mesh, notes = robot_mesh(robot, file, packages)
    if mesh is None:
        return {}, notes
    target = out.with_name(f"{out.stem}_visuals.glb")
    try:
        write_glb(target, mesh)
    except OSError as error:
        raise InvalidInputError(
            "out", str(target), f"a file that can be written ({error})"
        ) from error
    notes.append(
        f"the mover is {target.name}: all visuals in one mesh, joints at zero, the origin at"
        " base_link. It stands on its lowest point (anchor: base); its way is an example"
    )
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", robot.name).strip("_-")[:60]
    mover = {
        "name": name if re.match("[A-Za-z]", name) else f"robot_{name}",
        "file": target.name,
        "label": LABEL,
        "semantic_id": SEMANTIC_ID,
        "trajectory": {"waypoints_m": [list(point) for point in WAY_M], "step_m": STEP_M},
    }
    return mover, notes
