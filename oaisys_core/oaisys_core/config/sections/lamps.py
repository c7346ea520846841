"""Configuration of lamps: light sources beside sun and sky, in the world or on the rig.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from oaisys_core.config.section import Position, Range, Section, Vector3, Within

MAX_LAMPS = 32
"""Most lamps of a world."""

LampName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
Channel = Annotated[float, Field(ge=0, le=1)]
Edge = Annotated[float, Field(ge=1e-3, le=1e3)]

_KINDS_WITH = {
    "direction": ("spot", "area"),
    "radius_m": ("point", "spot"),
    "cone_deg": ("spot",),
    "cone_softness": ("spot",),
    "width_m": ("area",),
    "height_m": ("area",),
}
"""By key, the kinds of lamps that have it."""


class LampConfig(Section):
    """A lamp. It lights the scene, but is itself invisible in all images.

    Attributes:
        kind: ``point`` shines in all directions, ``spot`` in a cone, ``area`` from one side of a
            rectangle.
        frame: Frame of position and direction: ``map``, or ``base_link`` for a lamp on the rig,
            such as a headlight.
        position_m: Position of the lamp's centre.
        on_ground: Whether z is relative to the ground below; only in ``map``.
        direction: Direction in which a spot or area lamp shines, of any length. None is downwards
            in ``map``, and ahead (+x) in ``base_link``.
        strength_w: Power in Blender's scene units, in which the sun has ``sun_strength_w_m2``. At
            the distance d, a point lamp causes an irradiance of strength / (4 pi d²) on a surface
            that faces it; a spot does so in its cone. An area lamp emits this power by Lambert's
            law.
        color_srgb: Colour; its linear values are factors on the strength.
        radius_m: Radius of a point or spot lamp; a larger one casts softer shadows. None is 0.05.
        cone_deg: Full angle of a spot's cone. None is 60.
        cone_softness: How far the light of a spot fades from the cone's edge (0: not at all)
            towards its axis (1), as Blender's blend. None is 0.15.
        width_m, height_m: Edge lengths of an area lamp; the width is horizontal. None is 1.
        enabled: Whether the lamp is on.
    """

    kind: Literal["point", "spot", "area"] = "point"
    frame: Literal["map", "base_link"] = "map"
    position_m: Position
    on_ground: bool = False
    direction: Vector3 | None = None
    strength_w: Annotated[Range, Within(0.0, 1e9)] = (100.0, 100.0)
    color_srgb: tuple[Channel, Channel, Channel] = (1.0, 1.0, 1.0)
    radius_m: Annotated[float, Field(ge=0, le=100)] | None = None
    cone_deg: Annotated[float, Field(ge=1, le=180)] | None = None
    cone_softness: Channel | None = None
    width_m: Edge | None = None
    height_m: Edge | None = None
    enabled: bool = True

    @field_validator(*_KINDS_WITH)
    @classmethod
    def _fits_kind(cls, value: Any, info: ValidationInfo) -> Any:
        kind, kinds = info.data.get("kind"), _KINDS_WITH[str(info.field_name)]
        if value is not None and kind is not None and kind not in kinds:
            only = " and ".join(kinds)
            raise ValueError(f"expected nothing for a {kind} lamp: only {only} lamps have it")
        return value

    @field_validator("direction")
    @classmethod
    def _has_length(cls, value: Vector3 | None) -> Vector3 | None:
        if value is not None and not 1e-6 <= sum(part * part for part in value) ** 0.5 <= 1e6:
            raise ValueError("expected a vector of a length from 1e-6 to 1e6")
        return value

    @field_validator("on_ground")
    @classmethod
    def _is_in_map(cls, value: bool, info: ValidationInfo) -> bool:
        if value and info.data.get("frame") == "base_link":
            raise ValueError("expected false for a lamp in base_link")
        return value
