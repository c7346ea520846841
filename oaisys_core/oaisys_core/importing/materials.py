"""Import of the materials of the ground."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.files.documents import parse_json, read_text
from oaisys_core.importing.context import ImportContext
from oaisys_core.importing.document import Json, entries, part, span
from oaisys_core.importing.forms import TEXTURE, check_forms
from oaisys_core.importing.stand_ins import StandIns

STAND_INS = {
    "rock": "bedrock",
    "stone": "pebbles",
    "beach": "sand",
    "sand": "sand",
    "dry": "clay_cracks",
    "asteroid": "regolith",
    "gravel": "gravel",
    "mud": "mud",
    "snow": "snow",
    "grass": "grass",
    "moss": "moss",
    "forest": "leaf_litter",
}
NO_STAND_IN = "soil"
POOL_KEY = re.compile(r"terrainTextureList(\d*)")


def material(document: Json, name: str) -> Json:
    """Return the parameters of the material with a name, or of the first one."""
    found = entries(document, "ASSET_SETUP", "MATERIALS")
    named = [entry for entry in found if entry.get("name") == name] or found[:1]
    return part(named[0], "materialParams") if named else {}


def materials(document: Json, job: ImportContext, name: str, extent_m: float) -> Json:
    """Return the section ``materials`` for a stage with that material."""
    params = material(document, name)
    general = part(params, "general")
    pools = [
        {
            "layers": [_layer(entry, general, job, extent_m) for entry in layers],
            "count": _count(general),
            "replacement": bool(general.get("withReplacement", False)),
        }
        for layers in _pools(params)
    ]
    if not pools:
        return {}
    noise = part(general, "mergingNoise")
    return {
        "pools": pools,
        "label_borders": "hard" if general.get("hardLabelBorders", True) else "soft",
        "displacement": "geometry",
        "mask": {
            "method": "noise",
            "noise": {
                "scale": span(noise.get("Scale"), (3.0, 7.0)),
                "detail": span(noise.get("Detail"), (1.0, 3.0)),
                "roughness": span(noise.get("Roughness"), (0.2, 0.5)),
                "distortion": span(noise.get("Distortion"), (0.0, 0.6)),
            },
        },
    }


def stand_in(name: str) -> str:
    """Return the built-in texture set that fits a name best."""
    return next((ours for word, ours in STAND_INS.items() if word in name.lower()), NO_STAND_IN)


def texture_labels(entry: Json, job: ImportContext, name: str) -> tuple[Json, Json | None]:
    """Return the labels of a texture, and its label image if it has one."""
    vectors = part(entry, "passParams", "semantic_label").get("labelIDVec") or [[]]
    vector: list[Any] = list(vectors[0])
    ids = [0 if isinstance(value, Mapping) else int(value) for value in vector]
    labels = job.labels(ids, name)
    for level, value in enumerate(vector):
        if isinstance(value, Mapping):
            mapping = job.mapping(dict(value), level, ids, name)
            path = str(value.get("filePath"))
            image = job.file(
                path, f"one label for all of {name}", partial(_stripes, path=path, mapping=mapping)
            )
            if image is not None:
                return labels, {"image": str(image), "mapping": mapping}
    return labels, None


def _stripes(made: StandIns, path: str, mapping: Json) -> Path:
    return made.label_image(path, mapping)


def _pools(params: Json) -> list[list[Json]]:
    """Return the lists of textures; numbered lists replace the one without a number."""
    found = {match[1]: value for key, value in params.items() if (match := POOL_KEY.fullmatch(key))}
    if len(found) > 1:
        found.pop("", None)
    return [[dict(entry) for entry in found[key]] for key in sorted(found) if found[key]]


def _count(general: Json) -> list[int]:
    least, most = int(general.get("minNumMixTerrains", 1)), int(general.get("maxNumMixTerrains", 1))
    # -1 means all; larger numbers than there are also draw all.
    least, most = (1000 if n < 0 else n for n in (least, most))
    return [min(least, most), most]


def _layer(entry: Json, general: Json, job: ImportContext, extent_m: float) -> Json:
    entry = _with_template(entry, job)
    path = PurePosixPath(str(entry.get("path") or entry.get("templatePath", "texture")))
    folder_name = str(path.parent if path.suffix else path)
    base = entry.get("basePath") or general.get("baseTexturePath")
    overwrites = general.get("baseTexturePathOverwriteEnabled", True)
    if base and overwrites and not entry.get("noPathOverwrite"):
        folder_name = str(PurePosixPath(str(base)) / folder_name)
    name = PurePosixPath(folder_name).name
    texture = stand_in(name)
    folder = job.material_folder(folder_name, texture)
    labels, image = texture_labels(entry, job, name)
    layer: Json = {
        **labels,
        **({"texture": texture} if folder is None else {"folder": str(folder)}),
        "tile_m": extent_m / max(float(entry.get("size", 1.0)), 1e-6),
        "normal_strength": float(general.get("normalStrength", 1.0))
        * float(entry.get("normalStrength", 1.0)),
        **_relief(entry, float(general.get("dispScale", 1.0))),
        **_tiling(entry),
        **_color(entry),
    }
    return layer | ({"labels_from": image} if image else {})


def _with_template(entry: Json, job: ImportContext) -> Json:
    """Return the keys of a texture, merged into those of its template file."""
    name = entry.get("templatePath")
    if name is None:
        return entry
    file = job.file(str(name), "defaults and the name of its folder")
    return {**(_template(file) if file is not None else {}), **entry}


def _template(file: Path) -> Json:
    """Return the keys of a texture in a file."""
    try:
        found = parse_json(read_text(file))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: is not a readable JSON file: {error}") from error
    try:
        if not isinstance(found, dict):
            raise InvalidInputError("(whole file)", found, "an object with keys of a texture")
        check_forms(found, TEXTURE)
    except InvalidInputError as error:
        raise ConfigError(f"{file}: {error}") from error
    return found


def _relief(entry: Json, scale: float) -> Json:
    if "dispStrength" in entry:
        height_m = [float(entry["dispStrength"])] * 2
    elif "dispmapStrength" in entry:
        height_m = span(entry["dispmapStrength"][0])
    elif "dispColorStopColor_1" in entry:
        low = entry.get("dispColorStopColor_0", [0.0])[0]
        height_m = [float(entry["dispColorStopColor_1"][0]) - float(low)] * 2
    else:
        return {}
    return {"displacement_m": span([v * scale for v in height_m])}


def _tiling(entry: Json) -> Json:
    turn_deg = float(entry.get("mosaicRotation", 0.0))
    if entry.get("tilingMode") == "VORONOI_STYLE":
        return {"anti_tiling": "voronoi", "rotation_deg": min(turn_deg / 2, 180.0) or 180.0}
    if turn_deg > 0:
        return {"anti_tiling": "voronoi", "rotation_deg": min(turn_deg / 2, 180.0)}
    return {}


def _color(entry: Json) -> Json:
    curves = {
        ours: [[float(x), float(y)] for x, y in part(entry, "colorAdjustment")[theirs]]
        for theirs, ours in (
            ("cColorPoints", "combined"),
            ("rColorPoints", "red"),
            ("gColorPoints", "green"),
            ("bColorPoints", "blue"),
        )
        if theirs in part(entry, "colorAdjustment")
    }
    varied = part(entry, "colorVariation")
    color: Json = {"curves": curves} if curves else {}
    if "hue" in varied:
        color["hue_deg"] = (float(varied["hue"]) - 0.5) * 360
    for theirs, ours in (("saturation", "saturation"), ("brithness", "value")):
        if theirs in varied:
            color[ours] = max(float(varied[theirs]), 1e-3)
    return {"color": color} if color else {}
