"""Sky, ground and rocks of a body or a preset, where a configuration does not say how they look."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError

from oaisys_core.config.sections.stage import Body, body_name

Section = dict[str, Any]

SKY_OF_BODY: dict[str, Section] = {
    "moon": {"model": "none"},
    "mars": {
        "model": "plain",
        "zenith_srgb": (0.68, 0.56, 0.43),
        "horizon_srgb": (0.85, 0.71, 0.53),
        "glow_srgb": (0.55, 0.52, 0.50),
        "glow_deg": 14.0,
    },
}
"""Of the Moon and Mars: black, and dust that is paler around the sun and at the horizon."""

LAYERS_OF_BODY: dict[str, tuple[Section, ...]] = {
    "moon": ({"texture": "regolith", "label": "regolith", "semantic_id": 91},),
    "mars": (
        {"texture": "red_sand", "label": "red sand", "semantic_id": 92},
        {"texture": "gravel_dark", "label": "black gravel", "semantic_id": 93},
    ),
}
"""Ids of their own: variants of one configuration may lie on several bodies."""

GRAVEL: Section = {"texture": "gravel", "label": "gravel", "semantic_id": 1}
SAND: Section = {"texture": "sand", "label": "sand", "semantic_id": 2}
ROCK_WALLS: Section = {
    "texture": "bedrock",
    "label": "bedrock",
    "semantic_id": 94,
    "when": {"slope_deg": (32.0, 90.0), "soft_deg": 10.0},
}

LAYERS_OF_PRESET: dict[str, tuple[Section, ...]] = {
    **dict.fromkeys(("canyon", "mesa", "mountain_1", "mountain_2"), (GRAVEL, SAND, ROCK_WALLS)),
    "alpine": (
        GRAVEL,
        {
            "texture": "turf",
            "label": "turf",
            "semantic_id": 95,
            "when": {"slope_deg": (0.0, 30.0), "soft_deg": 8.0},
        },
        ROCK_WALLS,
    ),
    "badlands": (
        {"texture": "soil", "label": "soil", "semantic_id": 96},
        {
            "texture": "soil",
            "label": "clay",
            "semantic_id": 97,
            "color": {"saturation": (0.55, 0.55), "value": (1.2, 1.2)},
        },
    ),
    **dict.fromkeys(
        ("dunes", "slab_dunes"),
        (SAND, {"texture": "rippled_sand", "label": "rippled sand", "semantic_id": 98}),
    ),
    "river_bed": ({"texture": "pebbles", "label": "pebbles", "semantic_id": 99}, SAND),
    "volcanic_field": (
        {"texture": "lava", "label": "lava", "semantic_id": 100},
        {"texture": "gravel_dark", "label": "cinder", "semantic_id": 101},
    ),
}
"""What grounds on Earth are made of, if it is not gravel and sand; each name has one id."""

ROCK_TEXTURE = "basalt"
"""Of both bodies: what lies on the Moon's plains and most of Mars."""

ROCKS_OF_PRESET: dict[str, Section] = {"volcanic_field": {"rock_texture": "basalt"}}
"""What rocks on Earth are made of, if it is not the default."""

_BODY: TypeAdapter[Any] = TypeAdapter(Body)


def with_defaults_of_stage(data: Mapping[str, Any]) -> Section:
    """Return a configuration's data with what it does not say and its ``stage`` does.

    That is ``materials.layers`` where there are no pools, ``assets.rock_texture``, and for another
    body than Earth ``environment.sky``. What is not valid is returned as it is, to be refused where
    it is checked.
    """
    result = dict(data)
    for section, values in _defaults_of(data.get("stage")).items():
        given = data.get(section, {})
        if isinstance(given, Mapping):
            kept = {k: v for k, v in values.items() if k != "layers" or not given.get("pools")}
            result[section] = {**kept, **given}
    return result


def _defaults_of(stage: Any) -> dict[str, Section]:
    if not isinstance(stage, Mapping):
        return {}
    name = _body_of(stage)
    if name in SKY_OF_BODY:
        return {
            "environment": {"sky": SKY_OF_BODY[name]},
            "materials": {"layers": LAYERS_OF_BODY[name]},
            "assets": {"rock_texture": ROCK_TEXTURE},
        }
    preset = stage.get("preset")
    if not isinstance(preset, str) or preset not in LAYERS_OF_PRESET:
        return {}
    rocks = {"assets": ROCKS_OF_PRESET[preset]} if preset in ROCKS_OF_PRESET else {}
    return {"materials": {"layers": LAYERS_OF_PRESET[preset]}, **rocks}


def _body_of(stage: Mapping[str, Any]) -> str | None:
    if "body" not in stage:
        return None
    try:
        return body_name(_BODY.validate_python(stage["body"]))
    except ValidationError:
        return None
