"""The sky of a body, where a configuration does not say how its sky looks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError

from oaisys_core.config.sections.stage import Body, body_name

SKY_OF_BODY: dict[str, dict[str, Any]] = {
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

_BODY: TypeAdapter[Any] = TypeAdapter(Body)


def with_sky_of_body(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration's data with the sky of its ``stage.body``, if it has no sky itself.

    What is not valid is returned as it is, to be refused where it is checked.
    """
    result = dict(data)
    stage, environment = data.get("stage"), data.get("environment", {})
    if not isinstance(stage, Mapping) or not isinstance(environment, Mapping):
        return result
    if "sky" in environment or "body" not in stage:
        return result
    try:
        name = body_name(_BODY.validate_python(stage["body"]))
    except ValidationError:
        return result
    if name in SKY_OF_BODY:
        result["environment"] = {**environment, "sky": SKY_OF_BODY[name]}
    return result
