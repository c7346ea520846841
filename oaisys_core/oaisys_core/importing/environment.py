"""Import of sky and sun."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from oaisys_core.importing.context import ImportContext
from oaisys_core.importing.document import Json, entries, part, span
from oaisys_core.importing.stand_ins import StandIns

BACKGROUND = 0.1
"""Background strength of the original that corresponds to our sky strength of 1."""

SUN_W_M2 = 4.0
"""Our sun strength for the original's intensity of 1 at a background of `BACKGROUND`."""

CHOICES = {0: "cycle", 1: "random", 2: "shuffle"}


def environment(document: Json, job: ImportContext) -> Json:
    """Return the section ``environment``."""
    general = part(document, "ENVIRONMENT_EFFECTS_SETUP", "GENERAL")
    least, most = (v / BACKGROUND for v in span(general.get("backgroundStrength"), (BACKGROUND,)))
    found: Json = {"redraw": "sample", "step_interval": int(general.get("stepInterval", 1))}
    found["sky_strength"] = [least, most]
    effects = entries(document, "ENVIRONMENT_EFFECTS_SETUP", "ENVIRONMENT_EFFECTS")
    for effect in effects:
        params = part(effect, "environmentEffectsParams")
        if params.get("stepIntervalOption") == "LOCAL":
            found["step_interval"] = int(params.get("stepInterval", 1))
        if effect.get("type") == "EnvLightBlenderSky":
            found |= _sky(params, job, (least + most) / 2)
        elif effect.get("type") == "EnvHDRI":
            found |= _hdri(params, job, least, most)
        else:
            job.warn(f"the environment effect {effect.get('type')} is unknown and left out")
    return found | {"ground_beyond": False}


def _sky(params: Json, job: ImportContext, background: float) -> Json:
    turn = span(params.get("SunRotation"), (0.0, 360.0))
    sun = [v * SUN_W_M2 * background for v in span(params.get("SunIntensity"), (1.0,))]
    altitude_m = span(params.get("SunAltitude"), (3000.0, 3350.0))
    return {
        "sun_angular_diameter_deg": span(params.get("SunSize"), (0.545,)),
        "sun_strength_w_m2": sun,
        # Our sun does not shine at an elevation of 0.
        "sun_elevation_deg": [v or 0.01 for v in span(params.get("SunElevation"), (15.0, 90.0))],
        "sun_azimuth_deg": [90.0 - turn[1], 90.0 - turn[0]],
        "altitude_m": altitude_m,
        "air": span(params.get("AirDensity"), (1.0, 2.0)),
        "dust": span(params.get("DustDensity"), (0.0, 10.0)),
        "ozone": span(params.get("OzoneDensity"), (0.0, 5.0)),
    } | _sky_labels(params, job)


def _sky_labels(params: Json, job: ImportContext) -> Json:
    ids = [int(i) for i in part(params, "passParams", "SemanticPass").get("semanticIDVec", [])]
    if not ids:
        return {}
    job.name_label(ids[0], "sky")
    found: Json = {"sky_semantic_id": ids[0]}
    labels = job.labels(ids, "sky")
    return found | ({"sky_levels": labels["levels"]} if "levels" in labels else {})


def _hdri(params: Json, job: ImportContext, least: float, most: float) -> Json:
    images = []
    for entry in params.get("HDRIList") or []:
        path = str(entry.get("filePath"))
        file = job.file(path, "the computed sky", partial(StandIns.sky, name=path))
        if file is None:
            continue
        vector = list(entry.get("labelIDVec", []))
        images.append(
            {"file": str(file), "strength": [least * BACKGROUND, most * BACKGROUND]}
            | _image_labels(vector, job)
        )
    labels = _sky_labels(params, job)
    if not images:
        return labels
    choose = CHOICES.get(int(params.get("selectionOption", 0)), "random")
    return labels | {"hdri": {"images": images, "choose": choose}}


def _image_labels(vector: list[Any], job: ImportContext) -> Json:
    ids = [0 if isinstance(entry, Mapping) else int(entry) for entry in vector]
    found: Json = job.labels(ids, "sky") if ids else {}
    masks = []
    for level, entry in enumerate(vector):
        if not isinstance(entry, Mapping):
            continue
        path, mapping = str(entry.get("filePath")), job.mapping(dict(entry), 0, [0], "sky_part")
        stripes = partial(StandIns.label_image, name=path, mapping=mapping)
        image = job.file(path, "one label for the whole sky", stripes)
        if image is not None:
            masks.append({"image": str(image), "level": level, "mapping": mapping})
    return found | ({"labels_from": masks} if masks else {})
