"""Sun and sky in Blender: the sun's lamp, and the background shader."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from oaisys_core.procedural.environment.clouds.daylight import daylight_factors
from oaisys_core.procedural.environment.clouds.shadows import cloud_shadows
from oaisys_core.procedural.environment.light import plain_radiance, sun_color, veil_radiance
from oaisys_core.render.blender.compat import SKY_SCALE, node_tree_of, set_up_sky_node
from oaisys_core.render.blender.materials.haze import clear_share, set_haze
from oaisys_core.render.blender.materials.images import new_image
from oaisys_core.render.blender.materials.nodes import MIX_RESULT, NodeTree, Socket
from oaisys_core.render.blender.materials.photometric import set_law
from oaisys_core.render.blender.objects.cloud_shadows import CloudSheet
from oaisys_core.render.blender.objects.clouds import CloudPicture, before_sky
from oaisys_core.render.shading.shading import MIN_UP
from oaisys_core.scene.photometric_laws import PhotometricLaw
from oaisys_core.scene.sky import Color, Haze, Hdri, Sky, SkyImage

MIN_DISC_RAD = 1e-4
"""Least radius of the sun's disc in images: a point would be infinitely bright."""


class Background:
    """Blender's background shader, which Blender calls the world; rebuilt when the sky changes."""

    def __init__(self) -> None:
        self._world = bpy.data.worlds.new("world")
        bpy.context.scene.world = self._world
        self._image: Any = None
        self._image_of: SkyImage | None = None
        self._clouds = CloudPicture()

    def set(self, sky: Sky) -> None:
        """Rebuild the shader for a sky."""
        self._keep_image(sky.hdri.image if sky.hdri else None)
        self._clouds.set(sky)
        # Only an image may contain a sun that must be sampled as a light; without that, all light
        # samples go to the lamp.
        self._world.cycles.sampling_method = "AUTOMATIC" if sky.hdri else "NONE"
        tree = NodeTree(node_tree_of(self._world))
        direction = tree.add("TexCoord").outputs["Generated"]
        ray = _not_below(tree, direction) if sky.shows_plain and sky.dips else direction
        if sky.hdri is not None:
            color = self._hdri_color(tree, sky.hdri, ray)
        else:
            color = _sky_color(tree, sky, ray)
        disc = _disc_color(tree, sky, ray) if sky.sun_disc > 0 else None

        def with_color(color: Socket) -> Socket:
            """Return the background of a sky of this colour."""
            if sky.shows_plain:
                color = _above_ground(tree, sky, direction, color)
            if sky.haze is not None:
                color = _behind_haze(tree, sky, sky.haze, ray, color)
            return tree.add("Background", {"Color": color}).outputs[0]

        if not sky.shows_clouds:
            surface = with_color(color if disc is None else tree.vector("ADD", color, disc))
        else:
            lit = tree.vector("MULTIPLY", color, daylight_factors(sky))
            seen = tree.add("LightPath").outputs
            is_seen = tree.math("MAXIMUM", seen["Is Camera Ray"], seen["Is Glossy Ray"])
            # A background of its own, which Cycles evaluates for these rays only.
            seen_color = before_sky(tree, sky, self._clouds.along(tree, ray), color, disc)
            surface = tree.mix(is_seen, with_color(lit), with_color(seen_color))
        tree.add("OutputWorld", {"Surface": surface})

    def _hdri_color(self, tree: NodeTree, hdri: Hdri, ray: Socket) -> Socket:
        turned = tree.add(
            "VectorRotate", {"Vector": ray, "Angle": -hdri.rotation_rad}, rotation_type="Z_AXIS"
        ).outputs[0]
        texel = tree.add("TexEnvironment", {"Vector": turned}, image=self._image)
        return tree.scale(texel.outputs["Color"], hdri.strength)

    def _keep_image(self, image: SkyImage | None) -> None:
        if image is self._image_of:
            return
        # Before the new one: what cannot be made must not count as there the next time.
        self._image = self._image_of = None
        self._image = None if image is None else _new_image(image)
        self._image_of = image


def _sky_color(tree: NodeTree, sky: Sky, ray: Socket) -> Socket:
    if sky.model == "none":
        return _constant(tree, (0.0, 0.0, 0.0))
    if sky.model == "plain":
        return tree.scale(_gradient_color(tree, sky, ray), sky.sky_strength)
    node = tree.add("TexSky")
    set_up_sky_node(node, sky)
    return tree.scale(node.outputs[0], SKY_SCALE * sky.sky_strength)


def _gradient_color(tree: NodeTree, sky: Sky, ray: Socket) -> Socket:
    gradient = sky.gradient
    up = tree.math("MAXIMUM", _up(tree, ray), 0.0)
    zenith, horizon = np.array(gradient.zenith), np.array(gradient.horizon)
    is_root = gradient.power == 0.5
    share = tree.math("SQRT", up) if is_root else tree.math("POWER", up, gradient.power)
    change = tree.scale(tuple((zenith - horizon).tolist()), share)
    color = tree.vector("ADD", change, gradient.horizon)
    angle = tree.math("ARCCOSINE", _towards_sun(tree, sky, ray))
    near = tree.math("EXPONENT", tree.math("DIVIDE", angle, -gradient.glow_rad))
    return tree.vector("ADD", color, tree.scale(gradient.glow, near))


def _disc_color(tree: NodeTree, sky: Sky, ray: Socket) -> Socket:
    """Return the sun's disc, for camera rays only; its light comes from the lamp."""
    radius = max(sky.sun_angular_diameter_rad / 2, MIN_DISC_RAD)
    radiance = sky.sun_disc * sky.sun_strength_w_m2 / (pi * sin(radius) ** 2)
    inside = tree.math("GREATER_THAN", _towards_sun(tree, sky, ray), cos(radius))
    is_seen = tree.math("MULTIPLY", inside, tree.add("LightPath").outputs["Is Camera Ray"])
    return tree.scale(tuple(radiance * share for share in sun_color(sky)), is_seen)


def _not_below(tree: NodeTree, ray: Socket) -> Socket:
    """Return a direction, made horizontal if it points down: there the sky is as at the horizon."""
    x, y, z = tree.add("SeparateXYZ", {0: ray}).outputs
    return tree.combine(x, y, tree.math("MAXIMUM", z, 0.0))


def _above_ground(tree: NodeTree, sky: Sky, ray: Socket, color: Socket) -> Socket:
    """Return the sky's colour above the horizontal and the ground's below, for indirect light.

    The camera sees the mesh beyond the stage instead and, where the horizon dips, sky above it.
    """
    is_below = tree.math("LESS_THAN", _up(tree, ray), 0.0)
    if sky.dips:
        is_seen = tree.add("LightPath").outputs["Is Camera Ray"]
        is_below = tree.math("GREATER_THAN", is_below, is_seen)
    return tree.color_mix(is_below, color, (*plain_radiance(sky), 1.0)).outputs[MIX_RESULT]


def _behind_haze(tree: NodeTree, sky: Sky, haze: Haze, ray: Socket, color: Socket) -> Socket:
    """Return the sky's colour behind a horizontal layer of haze."""
    up = tree.math("MAXIMUM", _up(tree, ray), MIN_UP)
    clear = clear_share(tree, haze, tree.math("DIVIDE", haze.thickness_m, up))
    airlight = tree.vector(
        "MULTIPLY", tree.vector("SUBTRACT", 1.0, clear), veil_radiance(sky, haze)
    )
    return tree.vector("ADD", tree.vector("MULTIPLY", color, clear), airlight)


def _up(tree: NodeTree, ray: Socket) -> Socket:
    return tree.add("SeparateXYZ", {0: ray}).outputs["Z"]


def _towards_sun(tree: NodeTree, sky: Sky, ray: Socket) -> Socket:
    """Return the cosine of the angle between a ray and the direction of the sun."""
    return tree.math("MINIMUM", tree.dot(ray, sky.to_sun), 1.0)


def _constant(tree: NodeTree, color: Color) -> Socket:
    socket = tree.add("RGB").outputs[0]
    socket.default_value = (*color, 1.0)
    return socket


def _new_image(image: SkyImage) -> Any:
    rows, cols, _ = image.radiance.shape
    pixels = np.ones((rows, cols, 4), dtype=np.float32)
    pixels[..., :3] = image.radiance[::-1]
    return new_image(image.name, pixels, is_float=True, is_color=False)


class Lights:
    """A sun lamp, a sky without the sun's disc, and haze.

    A lamp needs far fewer samples than a bright spot in the sky.
    """

    def __init__(self) -> None:
        lamp = bpy.data.lights.new("sun", "SUN")
        self._sun = bpy.data.objects.new("sun", lamp)
        bpy.context.scene.collection.objects.link(self._sun)
        self._background = Background()
        self._cloud_sheet = CloudSheet()
        self._sky: Sky | None = None
        self._law: PhotometricLaw | None = None

    def set(self, sky: Sky, law: PhotometricLaw | None) -> bool:
        """Take over a sky and the ground's law; return whether they differ from those before."""
        if sky == self._sky and law == self._law:
            return False
        self._sky = None  # until all of it is there
        if law is not None or self._law is not None:
            set_law(law, sky)
        self._law = law
        self._sun.rotation_mode = "QUATERNION"
        self._sun.rotation_quaternion = Vector(sky.to_sun).to_track_quat("Z", "Y")
        lamp: Any = self._sun.data
        lamp.energy = sky.lamp_w_m2
        lamp.angle = sky.sun_angular_diameter_rad
        lamp.color = sun_color(sky)
        # A dark lamp would still be sampled.
        self._sun.hide_render = sky.lamp_w_m2 <= 0
        self._background.set(sky)
        self._cloud_sheet.set(cloud_shadows(sky))
        set_haze(sky)
        self._sky = sky
        return True
