"""Sky, ground and rocks of a body, where a configuration does not say how they look."""

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
        "zenith_srgb": (0.68, 0.50, 0.32),
        "horizon_srgb": (0.85, 0.69, 0.48),
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

ROCK_TEXTURE = "basalt"
"""Of both: what lies on the Moon's plains and most of Mars."""

_BODY: TypeAdapter[Any] = TypeAdapter(Body)


def with_defaults_of_body(data: Mapping[str, Any]) -> Section:
    """Return a configuration's data with what it does not say and its ``stage.body`` does.

    That is ``environment.sky``, ``materials.layers`` where there are no pools, and
    ``assets.rock_texture``. What is not valid is returned as it is, to be refused where it is
    checked.
    """
    result = dict(data)
    name = _body_of(data.get("stage"))
    if name not in SKY_OF_BODY:
        return result
    defaults: dict[str, Section] = {
        "environment": {"sky": SKY_OF_BODY[name]},
        "materials": {"layers": LAYERS_OF_BODY[name]},
        "assets": {"rock_texture": ROCK_TEXTURE},
    }
    for section, values in defaults.items():
        given = data.get(section, {})
        if isinstance(given, Mapping) and not given.get("pools"):
            result[section] = {**values, **given}
    return result


def _body_of(stage: Any) -> str | None:
    if not isinstance(stage, Mapping) or "body" not in stage:
        return None
    try:
        return body_name(_BODY.validate_python(stage["body"]))
    except ValidationError:
        return None
