"""Import of stages and of the objects on them."""

from __future__ import annotations

import math
import re
from functools import partial
from pathlib import Path

import numpy as np

from oaisys_core.geometry import pose_from_matrix, transform
from oaisys_core.importing.context import ImportContext
from oaisys_core.importing.document import Json, entries, part, span
from oaisys_core.importing.frames import blender_rotation
from oaisys_core.importing.materials import material, stand_in, texture_labels
from oaisys_core.importing.stand_ins import StandIns

PRESETS = frozenset(
    {
        "another_noise",
        "canyon",
        "dunes",
        "large_terrain",
        "mesa",
        "mounds",
        "mountain_1",
        "mountain_2",
    }
)
BODY_SIZE_M = 500.0
"""Mean size to which the original scales an asteroid."""

BODY_HEIGHT_M = 3000.0
"""Height of bodies above the small plate that replaces a missing stage."""

SPACE = {"preset": "plane", "extent_m": 10.0, "resolution_px": 2}
LARGEST_FIRST = 0.02


def stage(document: Json, job: ImportContext) -> tuple[Json, str]:
    """Return the section ``stage`` and the name of its material."""
    found = entries(document, "ASSET_SETUP", "STAGES")
    if not found:
        job.warn("there is no stage: it is replaced by a plate of 10 m far below the objects")
        return dict(SPACE), ""
    if len(found) > 1:
        job.warn("there are several stages: the first one is used")
    kind, params = found[0].get("type"), part(found[0], "stageParams")
    name = str(params.get("assetMaterial", "terrain_01"))
    if kind == "StageBlenderObject":
        return _mesh_stage(params, job), name
    if kind != "StageBlenderLandscape":
        job.warn(f"the stage {kind} is unknown: it is replaced by a ground of noise")
    preset = str(params.get("stageLandscapePreset", "another_noise"))
    if preset not in PRESETS:
        job.warn(f"the preset {preset} is unknown: it is replaced by another_noise")
        preset = "another_noise"
    return {"preset": preset, "extent_m": float(params.get("stageSizeX", 200))}, name


def _mesh_stage(params: Json, job: ImportContext) -> Json:
    if params.get("stageDisplacementActive", True):
        relief_m = abs(float(params.get("stageDisplacementStrength", 10.0)))
        return {"preset": "another_noise", "extent_m": 200.0, "relief_m": relief_m}
    path = str(params.get("stageFilePath"))
    file = job.file(path, "a plane of 200 m", partial(StandIns.ground, name=path))
    if file is None:
        return {"preset": "plane", "extent_m": 200.0}
    mesh = {"file": str(file)}
    if params.get("meshInstanceName") and not _is_stand_in(file, path):
        mesh["object"] = str(params["meshInstanceName"])
    return {"mesh": mesh}


def assets(document: Json, job: ImportContext, extent_m: float) -> tuple[Json, dict[str, Json]]:
    """Return the section ``assets``, and the positions of objects that a rig may look at."""
    groups: list[Json] = []
    objects: list[Json] = []
    targets: dict[str, Json] = {}
    for index, entry in enumerate(entries(document, "ASSET_SETUP", "MESHES")):
        params = part(entry, "meshParams")
        name = re.sub(r"[^A-Za-z0-9_-]", "_", str(entry.get("name", "")))
        name = name if re.match(r"[A-Za-z]", name) else f"mesh_{index}"
        if entry.get("type") == "MeshMultipleRandom":
            groups.append(_group(name, params, job, extent_m))
        elif entry.get("type") == "MeshAsteroid":
            body = _body(name, params, document, job)
            objects.append(body)
            targets[str(entry.get("name"))] = {
                "position_m": [*body["position_m"][:2], body["position_m"][2] + _middle_m(body)],
                "radius_m": BODY_SIZE_M / 2,
            }
        else:
            job.warn(f"the mesh {name} of the type {entry.get('type')} is unknown and left out")
    return {"rocks": [], "groups": groups, "objects": objects}, targets


def _look(params: Json, job: ImportContext, shape: str) -> Json:
    path = str(params.get("meshFilePath"))
    file = job.file(path, f"the built-in shape {shape}", lambda made: made.mesh(path, shape))
    if file is None:
        return {"shape": shape}
    if _is_stand_in(file, path):  # without colours
        return {"file": str(file), "texture": "rock"}
    name = params.get("meshInstanceName")
    return {"file": str(file), **({"object_name": str(name)} if name else {})}


def _is_stand_in(file: Path, original: str) -> bool:
    """Return whether a mesh replaces one of another format; it then has no named objects."""
    return file.stem == Path(original).stem and file.suffix != Path(original).suffix


def _labels(params: Json, job: ImportContext, name: str) -> Json:
    vectors = part(params, "passParams", "semantic_label").get("labelIDVec") or [[]]
    return job.labels([int(value) for value in vectors[0]], name)


def _group(name: str, params: Json, job: ImportContext, extent_m: float) -> Json:
    density = part(params, "densityMapSettings") if params.get("useDensityMap", True) else {}
    count = density.get("numberInstances") or params.get("numberInstances", [300, 500])
    size_m = float(params.get("defaultSize", 1.0))
    spread = min(max(float(params.get("strengthRandomScale", 1.0)), 0.0), 1.0)
    group: Json = {
        "name": name,
        **_look(params, job, "angular"),
        **_labels(params, job, name),
        "count": [int(v) for v in span(count)],
        "probability": 0.5 if params.get("randomSwitchOnOff") else 1.0,
        # The size of the mesh is unknown; most original meshes are about 1 m large.
        "size_m": [size_m * max(1.0 - spread, LARGEST_FIRST), size_m],
        "size_distribution": "uniform",
        "spacing": 0.0,
        "max_slope_deg": 90.0,
        **_attitude(params),
    }
    map_settings = part(density, "densityMap")
    if map_settings:
        group["density"] = _density(map_settings, job, extent_m)
    return group


def _attitude(params: Json) -> Json:
    if not params.get("randomRotationEnabled", True):
        return {"yaw_deg": 0.0, "tilt_deg": 0.0, "align": 0.0}
    middle = 180.0 * float(params.get("rotationOptionPhase", 0.3))
    half = 180.0 * float(params.get("rotationOptionPhaseRandom", 0.7))
    return {
        "align": 1.0 if params.get("rotationOptionMode", "NOR") == "NOR" else 0.0,
        "tilt_deg": 90.0 * min(max(float(params.get("rotationOptionFactor", 0.4)), 0.0), 1.0),
        "yaw_deg": [middle - half, middle + half],
    }


def _density(settings: Json, job: ImportContext, extent_m: float) -> list[Json]:
    kind = settings.get("noiseType", "VORONOI")
    if kind == "BLEND":
        job.warn("a gradient as density map is left out: objects are scattered evenly")
        return []
    # Texture coordinates run from -1 to 1 over the stage.
    cell_m = float(settings.get("size", 0.25)) / float(settings.get("scale", 1.0)) * extent_m / 2
    if kind != "VORONOI":
        return [{"kind": "noise", "scale_m": max(cell_m, 1e-3), "cover": _cover(settings, 2.0)}]
    return [{"kind": "voronoi", "cell_m": max(cell_m, 1e-3), "cover": _cover(settings, 1.0)}]


def _cover(settings: Json, power: float) -> float:
    """Return the approximate share of the stage on which a density map places objects.

    Objects stand where the noise exceeds the middle of the ramp. The distance to the nearest of
    random points exceeds r with probability exp(-4/3 pi r**3).
    """
    ends = [float(settings.get(f"colorStopPosition_{i}", i)) for i in (0, 1)]
    white = [sum(settings.get(f"colorStopColor_{i}", [i, i, i])[:3]) for i in (0, 1)]
    threshold = max(sum(ends) / 2, 0.0) / max(float(settings.get("intensity", 1.0)), 1e-6) / power
    beyond = math.exp(-4 / 3 * math.pi * threshold**3)
    return round(beyond if white[1] >= white[0] else 1 - beyond, 3)


def _body(name: str, params: Json, document: Json, job: ImportContext) -> Json:
    has_stage = bool(entries(document, "ASSET_SETUP", "STAGES"))
    found: Json = {"name": name, **_look(params, job, "rounded")}
    labels = _labels(params, job, name)
    if "assetMaterial" in params:
        layers = material(document, str(params["assetMaterial"])).get("terrainTextureList", [])
        if layers:
            first = dict(layers[0])
            path = str(first.get("path") or first.get("templatePath", "rock"))
            found["texture"] = stand_in(path)
            found["tile_m"] = BODY_SIZE_M / 8
            job.warn(f"{name}: objects get built-in textures, here {found['texture']}")
            of_material, image = texture_labels(first, job, name)
            labels = of_material if of_material["semantic_id"] else labels
            if image is not None:
                job.warn(f"{name}: labels within the texture of an object are left out")
    x, y, z = _place(params)
    height_m = 0.0 if has_stage else BODY_HEIGHT_M
    return (
        found
        | labels
        | {
            "position_m": [x, y, z + height_m - _middle_m(found)],
            "quat_xyzw": _turn(params),
            "scale": BODY_SIZE_M,
        }
    )


def _middle_m(body: Json) -> float:
    """Return the height of a body's middle above its base; built-in rocks are rather flat."""
    return BODY_SIZE_M * (0.3 if "shape" in body else 0.5)


def _place(params: Json) -> tuple[float, float, float]:
    place = params.get("location", "origin")
    if isinstance(place, list):
        return float(place[0]), float(place[1]), float(place[2])
    if place == "trajectory_simulation":
        box = [float(v) for v in params.get("trajectorySimulation", [0] * 6)]
        return (box[0] + box[1]) / 2, (box[2] + box[3]) / 2, (box[4] + box[5]) / 2
    return 0.0, 0.0, 0.0


def _turn(params: Json) -> list[float]:
    """Return the orientation of Blender's angles about the fixed axes x, y and z, in this order."""
    if "rotation_rad" in params:
        angles = [float(v) for v in params["rotation_rad"]]
    else:
        angles = [math.radians(float(v)) for v in params.get("rotation_deg", [0, 0, 0])]
    rotation = np.eye(3)
    for axis, angle in enumerate(angles):
        quat = [math.cos(angle / 2), 0.0, 0.0, 0.0]
        quat[1 + axis] = math.sin(angle / 2)
        rotation = blender_rotation(quat) @ rotation
    return list(pose_from_matrix(transform(rotation, (0.0, 0.0, 0.0))).quat_xyzw)
