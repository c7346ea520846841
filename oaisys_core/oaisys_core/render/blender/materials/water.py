"""The material of water, and of ground that is wet beside it."""

from __future__ import annotations

from functools import cache
from math import pi
from typing import Any

import numpy as np

from oaisys_core.render.blender.compat import node_tree_of
from oaisys_core.render.blender.materials.haze import through_haze
from oaisys_core.render.blender.materials.images import new_image
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.render.blender.materials.surfaces import (
    BY_CHANCE,
    PAINT,
    diffuse,
    new_material,
    show,
)
from oaisys_core.render.shading.looks import IOR, WET_DARKENING
from oaisys_core.render.shading.ripples import (
    FINEST_ALPHA,
    MAX_SLOPE,
    RIPPLE_TILES_M,
    RIPPLES_TO_M,
    ripple_slopes,
)
from oaisys_core.scene import MeshPrototype


def water_material(prototype: MeshPrototype) -> Any:
    """Return a material that reflects by Fresnel's law and hides the bottom with its depth.

    Light is not refracted, so that depth and labels, which end at the surface, fit the picture.
    The mesh must have `paint_vertices`, with the opacity as alpha.
    """
    water = prototype.water
    if water is None:
        raise ValueError(f"{prototype.name} is no water")
    result = new_material(prototype.name)
    result.pass_index = BY_CHANCE
    tree = NodeTree(node_tree_of(result))
    paint = tree.add("Attribute", attribute_name=PAINT)
    body, airlight = diffuse(tree, paint.outputs["Color"], 0.5, None)
    clear = tree.add("BsdfTransparent").outputs[0]
    below = tree.mix(paint.outputs["Alpha"], clear, body)
    slopes, variance = _ripples(tree, MAX_SLOPE * water.waves)
    leaning = tree.vector("ADD", slopes, _slope_towards_eye(tree, variance))
    # The glossy surface prefers facets that face the eye by itself, Fresnel's law does not.
    fresnel = tree.add("Fresnel", {"IOR": _ior(tree), "Normal": _normal(tree, leaning)}).outputs[0]
    seen, _ = through_haze(tree, (1.0, 1.0, 1.0, 1.0))
    # Blender's roughness is the root of alpha, and alpha is sqrt(2) deviations.
    spread = tree.math("MULTIPLY_ADD", variance, 2.0, FINEST_ALPHA**2)
    inputs: dict[str | int, Any] = {
        "Color": seen,
        "Roughness": tree.math("POWER", spread, 0.25),
        "Normal": _normal(tree, slopes),
    }
    # Slopes are normally distributed; the default has tails in which the sun would glitter afar.
    mirror = tree.add("BsdfGlossy", inputs, distribution="BECKMANN").outputs[0]
    show(tree, tree.mix(fresnel, below, mirror), airlight)
    return result


def wet(
    tree: NodeTree,
    surface: Socket,
    bank_m: tuple[float, float],
    extent_m: tuple[float, float, float, float] | None = None,
) -> Socket:
    """Return the ground's surface, dark up to the first height and dry from the second on.

    It is dry beyond ``extent_m``, if that is given.
    """
    low_m, high_m = bank_m
    x, y, height_m = tree.add(
        "SeparateXYZ", {0: tree.add("NewGeometry").outputs["Position"]}
    ).outputs
    width_m = max(high_m - low_m, 1e-3)
    share = tree.clamp("MULTIPLY_ADD", height_m, -1 / width_m, high_m / width_m)
    if extent_m is not None:
        x0, y0, x1, y1 = extent_m
        for place, first, last in ((x, x0, x1), (y, y0, y1)):
            from_middle = tree.math("ABSOLUTE", tree.math("SUBTRACT", place, (first + last) / 2))
            is_inside = tree.math("LESS_THAN", from_middle, (last - first) / 2)
            share = tree.math("MULTIPLY", share, is_inside)
    black = tree.add("BsdfDiffuse", {"Color": (0.0, 0.0, 0.0, 1.0)}).outputs[0]
    return tree.mix(tree.math("MULTIPLY", share, WET_DARKENING), surface, black)


def _ior(tree: NodeTree) -> Socket:
    """Return the index by which light that leaves the bottom straight on is that which entered.

    From below, Cycles takes its reciprocal: low light would be reflected in full, which has come
    from above, and the bottom would be black under a sun lower than 41 degrees.
    """
    is_below = tree.add("NewGeometry").outputs["Backfacing"]
    return tree.math("MULTIPLY_ADD", is_below, 1 / IOR - IOR, IOR)


def _ripples(tree: NodeTree, slope: float) -> tuple[Socket, Socket]:
    """Return the slopes of a rippled level surface, and the variance of those that it lacks.

    Args:
        slope: Standard deviation of its slope along one axis, close to the camera.
    """
    position = tree.add("NewGeometry").outputs["Position"]
    image = new_image("ripples", _ripple_pixels(), is_float=True, is_color=False)
    # Further away, a pixel sees many ripples, whose mean slope is small.
    distance_m = tree.add("CameraData").outputs["View Distance"]
    near = tree.clamp("DIVIDE", RIPPLES_TO_M, distance_m)
    slopes: Socket = (0.0, 0.0, 0.0)
    for tile_m in RIPPLE_TILES_M:
        place = tree.scale(position, 1 / tile_m)
        texel = tree.add("TexImage", {"Vector": place}, image=image).outputs["Color"]
        slopes = tree.vector("MULTIPLY_ADD", texel, (slope / 2**0.5, slope / 2**0.5, 0.0), slopes)
    squared = tree.math("MULTIPLY", near, near)
    variance = tree.math("MULTIPLY_ADD", squared, -(slope**2), slope**2)
    return tree.scale(slopes, near), variance


def _slope_towards_eye(tree: NodeTree, variance: Socket) -> Socket:
    """Return the slopes of `slope_towards_eye`, as a level vector."""
    to_eye = tree.add("NewGeometry").outputs["Incoming"]
    upward = tree.math("MAXIMUM", tree.component(to_eye, 2), 1e-3)
    level = tree.vector("MULTIPLY", to_eye, (1.0, 1.0, 0.0))
    tangents = tree.scale(level, tree.math("DIVIDE", 1.0, upward))
    steepness = tree.math("MULTIPLY", variance, tree.dot(tangents, tangents))
    shown = tree.math("SQRT", tree.math("MULTIPLY_ADD", steepness, 2 / pi, 1.0))
    return tree.scale(tangents, tree.math("DIVIDE", variance, shown))


def _normal(tree: NodeTree, slopes: Socket) -> Socket:
    return tree.vector("NORMALIZE", tree.vector("ADD", slopes, (0.0, 0.0, 1.0)))


@cache
def _ripple_pixels() -> Any:
    """Return (N, N, 4) slopes along x and y with standard deviation 1."""
    slopes = ripple_slopes()
    pixels = np.zeros((*slopes.shape[:2], 4), np.float32)
    pixels[..., :2], pixels[..., 3] = slopes, 1.0
    return pixels
