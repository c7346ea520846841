"""Import of the rig and its cameras."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

from oaisys_core.errors import ConfigError, quote
from oaisys_core.files.csv_tables import MAX_ROW_BYTES
from oaisys_core.files.documents import read_text
from oaisys_core.files.poses.records import MAX_POSES
from oaisys_core.importing.context import ImportContext
from oaisys_core.importing.document import Json, entries, part, span
from oaisys_core.importing.frames import (
    BODY_FROM_TRACKING,
    LINK_FROM_CAMERA,
    mount,
    rig_pose,
)
from oaisys_core.output.poses import append_pose

NO_PASSES: dict[str, list[int]] = {"RGBDPass": [1], "SemanticPass": [1, 1], "InstancePass": [1]}
DOWN_YAW_DEG = -90.0
"""With angles of 0, the original's base looks down with the image's upper edge towards -y."""


def sensors(document: Json, job: ImportContext, targets: dict[str, Json]) -> Json:
    """Return the section ``sensors``.

    Args:
        document: The original file.
        job: The state of the import.
        targets: ``position_m`` and ``radius_m`` of the objects that a rig may look at, by name.
    """
    general = part(document, "SENSOR_SETUP", "GENERAL")
    kind = general.get("sensorMovementType", "randomEuclideanTarget")
    body_from_base = BODY_FROM_TRACKING if kind == "centeredTarget" else LINK_FROM_CAMERA
    levels = _levels(document)
    passes = {entry.get("type") for entry in entries(document, "RENDER_SETUP", "RENDER_PASSES")}
    cameras: list[Json] = []
    for entry in entries(document, "SENSOR_SETUP", "SENSORS"):
        if entry.get("type") != "SensorCameraRGBD":
            job.warn(
                f"a sensor of the type {entry.get('type')} is left out: only cameras are supported"
            )
            continue
        params = part(entry, "sensorParams")
        pose = mount(params.get("transformation", [1, 0, 0, 1, 0, 0, 0]), body_from_base)
        cameras.append(
            {
                **_camera(params, len(cameras)),
                "mount_position_m": list(pose.position_m),
                "mount_quat_xyzw": list(pose.quat_xyzw),
                "modalities": _modalities(params, levels, passes),
            }
        )
    found: Json = {"cameras": cameras} if cameras else {}
    motion = _motion(general, document, job, targets)
    has_stage = bool(entries(document, "ASSET_SETUP", "STAGES"))
    return {**found, "motion": motion, "pose_policy": "clamp" if has_stage else "allow"}


def _levels(document: Json) -> int:
    for entry in entries(document, "RENDER_SETUP", "RENDER_PASSES"):
        if entry.get("type") == "SemanticPass":
            return int(part(entry, "passParams").get("numIter", 2))
    return 0


def _camera(params: Json, index: int) -> Json:
    width_px, height_px = params.get("imageResolution", [800, 500])
    K = params.get("KMatrix", [541.14, 0, 320, 0, 541.14, 240, 0, 0, 1])
    name = re.sub(r"[^a-z0-9_]", "_", str(params.get("outputBaseName", "camera")).lower())
    lens = part(params, "depthOfField")
    camera: Json = {
        "name": name if re.match(r"[a-z]", name) else f"camera_{index}",
        "width_px": int(width_px),
        "height_px": int(height_px),
        "fx_px": float(K[0]),
        "fy_px": float(K[4]),
        "cx_px": float(K[2]),
        "cy_px": float(K[5]),
    }
    if lens:
        camera["lens"] = {
            "focus_distance_m": float(lens.get("distance", 10.0)),
            "f_number": float(lens.get("fStop", 1.5)),
            "blades": int(lens.get("blades", 0)),
            "blade_rotation_deg": float(lens.get("rotationDeg", 0.0)),
            "ratio": float(lens.get("ratio", 1.0)),
        }
    return camera


def _modalities(params: Json, levels: int, passes: set[Any]) -> list[str]:
    wanted = params.get(
        "renderPasses", {name: {"activationSlot": s} for name, s in NO_PASSES.items()}
    )

    def slots(name: str) -> list[int]:
        return list(part(wanted, name).get("activationSlot", [])) if name in passes else []

    found = []
    if slots("RGBDPass")[:1] == [1]:
        found.append("rgb")
        if part(wanted, "RGBDPass").get("DepthEnabled", True):
            found.append("depth")
    on = slots("SemanticPass")[:levels]
    found += [f"semantic_{level}" for level, is_on in enumerate(on) if is_on == 1]
    if slots("InstancePass")[:1] == [1]:
        found.append("instance")
    return found or ["rgb"]


def _motion(general: Json, document: Json, job: ImportContext, targets: dict[str, Json]) -> Json:
    kind = general.get("sensorMovementType", "randomEuclideanTarget")
    shared: Json = {"step_interval": int(general.get("stepInterval", 1))}
    if kind == "centeredTarget":
        return shared | _around(general, document, job, targets)
    hover = _hover(general)
    if kind == "deterministic":
        return shared | hover | _from_file(general, job)
    if kind == "randomEuclidean":
        down = {"look": "down", "yaw_deg": DOWN_YAW_DEG}
        return shared | hover | {"kind": "random", "position_m": _box(general, "Euclidean")} | down
    if kind != "randomEuclideanTarget":
        job.warn(f"the movement {kind} is unknown: the rig hovers over the stage")
        return shared | hover | {"kind": "hover"}
    found: Json = {
        "kind": "look_at",
        "position_m": _box(general, "Euclidean"),
        "target_m": _box(general, "Target"),
        "target_is_offset": True,
        "roll_deg": span(general.get("randomTargetRollDeg")),
    }
    if general.get("hoverTargetModeEnabled"):
        found["target_above_ground_m"] = float(general.get("hoverTargetDistance", 0.0))
    return shared | hover | found


def _hover(general: Json) -> Json:
    if not general.get("hoverBaseModeEnabled"):
        return {}
    least, most = span(general.get("hoverBaseDistance"), (1.5,))
    if general.get("hoverTargetModeEnabled") and "hoverBaseDistanceNoise" in general:
        least /= 2
    return {"height_above_ground_m": [least, most]}


def _box(general: Json, what: str) -> list[list[float]]:
    low = general.get(f"random{what}PosMin", [0, 0, 0])
    high = general.get(f"random{what}PosMax", [0, 0, 0])
    return [span(pair) for pair in zip(low, high, strict=True)]


def _around(general: Json, document: Json, job: ImportContext, targets: dict[str, Json]) -> Json:
    name = str(general.get("targetObject", ""))
    target = targets.get(name) or next(iter(targets.values()), None)
    if target is None:
        job.warn(f"the target object {quote(name)} does not exist: the rig looks at the origin")
        target = {"position_m": [0.0, 0.0, 0.0], "radius_m": 1.0}
    radius_m = target["radius_m"]
    least, most = (
        max(radius_m * v, 1e-3) for v in span(general.get("sensorDistanceScale"), (2.0,))
    )
    found: Json = {
        "kind": "around_target",
        "target_m": target["position_m"],
        "distance_m": [least, most],
        # The original uses the octants of -x and +y, at any height.
        "azimuth_deg": [100.0, 170.0],
        "elevation_deg": [-30.0, 30.0],
        "redraw": "batch",
    }
    if general.get("landingMode"):
        steps = int(part(document, "SIMULATION_SETUP").get("numSamplesPerBatch", 2))
        end_m = radius_m * float(general.get("finalApproachDistance", 1.1))
        found["approach"] = {"distance_m": end_m, "steps": max(2, steps)}
    return found


def _from_file(general: Json, job: ImportContext) -> Json:
    name = str(general.get("sensorMovementPose", "poses.csv"))
    source = job.file(name, "a rig that hovers over the stage")
    if source is None:
        return {"kind": "hover"}
    target = (
        (job.out or Path("imported.yaml"))
        .with_suffix("")
        .with_name(f"{(job.out or Path('imported')).stem}_poses.csv")
    )
    _turn_poses(source, target)
    offset_m = [float(v) for v in general.get("deterministicSensorOffsetPos", [0, 0, 0])]
    return {"kind": "csv", "path": str(target.resolve()), "offset_m": offset_m}


def _turn_poses(source: Path, target: Path) -> None:
    """Convert the poses of an original file (frame, x, y, z, qw, qx, qy, qz) to our convention."""
    target.unlink(missing_ok=True)
    try:
        text = read_text(source, MAX_POSES * MAX_ROW_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{source}: cannot be read: {error}") from error
    for line, row in enumerate(csv.reader(text.splitlines()), start=1):
        try:
            append_pose(target, int(row[0]), rig_pose([float(value) for value in row[1:8]]))
        except (ValueError, IndexError) as error:
            expected = "a frame's number, x, y, z, qw, qx, qy, qz"
            raise ConfigError(
                f"{source}:{line}: received {quote(row)}, expected {expected}"
            ) from error
