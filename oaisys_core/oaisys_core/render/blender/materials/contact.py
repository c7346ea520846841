"""The contact of things with the ground: dust on their feet, and fines around them."""

from __future__ import annotations

from typing import Any

import numpy as np

from oaisys_core.procedural.contact_map import ContactMap
from oaisys_core.render.blender.materials.haze import through_haze
from oaisys_core.render.blender.materials.images import BYTE, new_image
from oaisys_core.render.blender.materials.nodes import MIX_RESULT, NodeTree, Socket
from oaisys_core.render.blender.objects.instances import BED, DUST, SIZE
from oaisys_core.render.shading.looks import (
    CONTACT,
    CONTACT_SHARE,
    DARK_FROM,
    DARKEST,
    DUST_ON_TOP,
    FINES_BRIGHTNESS,
    FINES_FROM,
    FINES_ROUGHNESS,
    MAX_DUST,
    MAX_FINES,
    TRACK_DARKENING,
)

DRIVEN = "driven"
"""Property of the ground with `driven_shares`."""


def with_dust(tree: NodeTree, color: Socket, roughness: Any, dust_m: float) -> Socket:
    """Return a colour under the ground's dust: all of it at the ground, on top a thin layer.

    Args:
        tree: The material's.
        color: Of the clean surface.
        roughness: 0 to 1, such as the texture's height; dust lies higher where it is low.
        dust_m: See `MeshPrototype`.
    """
    info = tree.add("ObjectInfo")
    geometry = tree.add("NewGeometry")
    size = tree.add("Attribute", attribute_type="INSTANCER", attribute_name=SIZE).outputs["Fac"]
    bed = tree.add("Attribute", attribute_type="INSTANCER", attribute_name=BED).outputs["Vector"]
    dust = tree.add("Attribute", attribute_type="INSTANCER", attribute_name=DUST).outputs["Vector"]
    offset = tree.vector("SUBTRACT", geometry.outputs["Position"], info.outputs["Location"])
    above = tree.add("SeparateXYZ", {0: offset}).outputs
    plane = tree.add("SeparateXYZ", {0: bed}).outputs
    ground = tree.math("MULTIPLY_ADD", above[0], plane[0], plane[2])
    ground = tree.math("MULTIPLY_ADD", above[1], plane[1], ground)
    height_m = tree.math("SUBTRACT", above[2], ground)
    share = tree.math("DIVIDE", height_m, tree.math("MULTIPLY", size, dust_m))
    ragged = tree.math("MULTIPLY", share, tree.math("MULTIPLY_ADD", roughness, 1.4, 0.4))
    foot = tree.math("MULTIPLY", tree.clamp("SUBTRACT", 1.0, ragged), MAX_DUST)
    upward = tree.add("SeparateXYZ", {0: geometry.outputs["Normal"]}).outputs[2]
    top = tree.clamp("MULTIPLY_ADD", upward, 2.0, -1.3)
    cover = tree.math("MAXIMUM", foot, tree.math("MULTIPLY", top, DUST_ON_TOP))
    uneven = tree.scale(dust, tree.math("MULTIPLY_ADD", roughness, 0.5, 0.7))
    dusty = tree.color_mix(cover, color, uneven).outputs[MIX_RESULT]
    # Fines at the very contact are damp and in the pores' shade.
    dark = tree.clamp("MULTIPLY_ADD", share, (1 - CONTACT) / CONTACT_SHARE, CONTACT)
    return tree.scale(dusty, dark)


def with_rims(
    tree: NodeTree,
    surface: Socket,
    fines: Any,
    extent_m: tuple[float, float, float, float],
    has_tracks: bool,
) -> tuple[Socket, Any]:
    """Return the ground's surface with fines around things, and the node of the map's image.

    Args:
        tree: The material's.
        surface: The ground's own.
        fines: Their colour; None only darkens the contact.
        extent_m: What the map covers.
        has_tracks: Whether the map has tracks, which are shown as far as the object's property
            `DRIVEN` says.
    """
    x0, y0, x1, y1 = extent_m
    position = tree.add("NewGeometry").outputs["Position"]
    size_inverse = (1.0 / (x1 - x0), 1.0 / (y1 - y0), 0.0)
    start = (-x0 / (x1 - x0), -y0 / (y1 - y0), 0.0)
    place = tree.vector("MULTIPLY_ADD", position, size_inverse, start)
    texel = tree.add("TexImage", {"Vector": place}, extension="CLIP")
    if has_tracks:
        surface = _with_tracks(tree, surface, texel.outputs["Color"])
    near = texel.outputs["Alpha"]
    gain = 1 / (1 - DARK_FROM)
    dark = tree.clamp("MULTIPLY_ADD", near, gain, -DARK_FROM * gain)
    if fines is None:
        share = tree.math("MULTIPLY", dark, 1 - DARKEST)
        return _darken(tree, surface, share), texel
    share = tree.clamp("MULTIPLY", near, 1 / FINES_FROM)
    share = tree.math("MULTIPLY", share, MAX_FINES)
    brightness = tree.math("MULTIPLY_ADD", dark, DARKEST - FINES_BRIGHTNESS, FINES_BRIGHTNESS)
    color, _ = through_haze(
        tree, tree.scale(fines[:3] if isinstance(fines, tuple) else fines, brightness)
    )
    inputs: dict[str | int, Any] = {"Color": color, "Roughness": FINES_ROUGHNESS}
    return tree.mix(share, surface, tree.add("BsdfDiffuse", inputs).outputs[0]), texel


def _with_tracks(tree: NodeTree, surface: Socket, passed: Socket) -> Socket:
    driven = tree.add("Attribute", attribute_type="OBJECT", attribute_name=DRIVEN).outputs["Vector"]
    ends = tree.add("SeparateXYZ", {0: driven}).outputs
    track: Socket = 0.0
    for end, value in zip(ends, tree.add("SeparateXYZ", {0: passed}).outputs, strict=True):
        is_passed = tree.math("LESS_THAN", value, end)
        # Sharp, but not stepped: from one texel to the next, values rise from 0.
        is_track = tree.clamp("MULTIPLY", value, 255.0)
        track = tree.math("MAXIMUM", track, tree.math("MULTIPLY", is_passed, is_track))
    return _darken(tree, surface, tree.math("MULTIPLY", track, TRACK_DARKENING))


def _darken(tree: NodeTree, surface: Socket, share: Socket) -> Socket:
    """Return a surface that reflects a share of its light less."""
    black = tree.add("BsdfDiffuse", {"Color": (0.0, 0.0, 0.0, 1.0)}).outputs[0]
    return tree.mix(share, surface, black)


def contact_image(contact: ContactMap | None) -> Any:
    """Return the image of a contact map, whose values are in alpha, which needs no conversion."""
    share = np.zeros((2, 2), np.uint8) if contact is None else contact.share
    pixels = np.zeros((*share.shape, 4), np.float32)
    np.multiply(share, BYTE, out=pixels[..., 3])
    if contact is not None and contact.passed is not None:
        np.multiply(contact.passed, BYTE, out=pixels[..., :3])
    return new_image("contact", pixels, is_float=False, is_color=False)
