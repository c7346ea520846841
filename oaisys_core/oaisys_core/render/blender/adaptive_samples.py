"""How many samples per pixel a view needs, from a few rays cast before it is rendered.

Where leaves, needles and their shadows change from one pixel to the next, denoising smears what few
samples have seen; on open ground, more samples gain little. Small images have as many as cost
little beside the rest of a view. The number depends on the world and the camera alone, so that the
same request gives the same image in every process.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from oaisys_core.geometry import unproject
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import NO_TARGET
from oaisys_core.scene import PlacedCamera
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import FloatArray

PLACES = 30, 40
"""Rows and columns of places in the image where rays are cast."""

PIXELS_BESIDE = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
"""Columns and rows of the pixels of a place."""

FARTHEST_M = 1e5
"""Range beyond which rays end."""

MAX_BEND = 0.01
"""Inverse depth is linear over a plane. Where it departs by a larger share, pixels see a step."""

ABOVE_SURFACE = 1e-3
"""Distance from the surface of rays to the sun, as a share of that from the camera."""

CLUTTER = 0.04, 0.22
"""Shares of cluttered places up to which a view is open ground, and from which it is all plants."""

SHADE = 0.5, 1.0
"""The same shares of the surface in shade, up to which a view is sunny, and from which it is all
shade."""

SHADE_WEIGHT = 2 / 3
"""How much of the range of samples shade alone asks for."""

SMALL_IMAGE = 20_000
"""Samples of an image that take little time beside what an image of any size does: six per pixel of
64×48 take 1.05 times as long as three."""

MANY_SAMPLES = 4
"""How many times as many samples such an image has where there are lamps: each sample is lit by one
light, and a bright spot of a few pixels is too small to be denoised by those beside it. As many
where ground has gloss: its albedo is that of the samples, in which denoising leaves the noise."""


class ViewNeed(NamedTuple):
    """What makes a view need samples, from 0 for none to 1.

    Attributes:
        clutter: How many places there are whose neighbouring pixels see different things.
        shade: How much of the surface the sun does not reach.
    """

    clutter: float
    shade: float


def adapt(
    surface: Surface,
    camera: PlacedCamera,
    settings: RenderSettings,
    *,
    has_gloss: bool = False,
) -> RenderSettings:
    """Return the settings with a view's own samples per pixel and clutter.

    Args:
        surface: What is seen.
        camera: Who sees it.
        settings: The bounds.
        has_gloss: Whether a layer of the ground has.
    """
    pixels = camera.intrinsics.width_px * camera.intrinsics.height_px
    if 0 < settings.small_samples * pixels <= SMALL_IMAGE:
        many = bool(surface.scene.lamps) or has_gloss
        small = settings.small_samples * (MANY_SAMPLES if many else 1)
        settings = settings.with_samples(max(settings.samples, small))
    is_adaptive = settings.max_samples > settings.samples
    if not is_adaptive and not (settings.denoise and settings.samples > 1):
        return settings
    need = view_need(surface, camera)
    most = max(settings.samples, settings.max_samples)
    samples = max(samples_for(need, settings.samples, most), min(most, SMALL_IMAGE // pixels))
    return replace(settings, samples=samples, clutter=need.clutter)


def view_need(surface: Surface, camera: PlacedCamera) -> ViewNeed:
    """Cast a few thousand rays, and return what the view needs samples for."""
    pixels = _places(camera.intrinsics.height_px, camera.intrinsics.width_px)
    rays = unproject(pixels.reshape(-1, 2), np.ones(pixels.size // 2), camera.intrinsics)
    length = np.linalg.norm(rays, axis=-1)
    directions = (rays / length[:, None]) @ camera.T_map_camera[:3, :3].T
    view = surface.cast(camera.T_map_camera[:3, 3], directions, FARTHEST_M)
    range_m = view.depth_m[:, 0]
    inverse = (length / range_m).reshape(-1, len(PIXELS_BESIDE))
    ids = view.instance_ids.reshape(-1, len(PIXELS_BESIDE))
    is_edge = ids.min(axis=1) != ids.max(axis=1)
    bend = np.abs(inverse @ (1, -1, -1, 1)) > MAX_BEND * inverse.max(axis=1)
    is_cluttered = is_edge | (bend & ids.any(axis=1))
    seen = np.arange(0, len(range_m), len(PIXELS_BESIDE))
    seen = seen[np.isfinite(range_m[seen])]
    shade = _shade(surface, view.points_m[seen, 0], directions[seen], range_m[seen])
    return ViewNeed(_between(CLUTTER, float(is_cluttered.mean())), _between(SHADE, shade))


def samples_for(need: ViewNeed, least: int, most: int) -> int:
    """Return the samples per pixel of a view, between two bounds."""
    return least + round((most - least) * max(need.clutter, SHADE_WEIGHT * need.shade))


def _places(height_px: int, width_px: int) -> FloatArray:
    """Return (N, 4, 2) columns and rows of the pixels of places spread over an image."""
    rows, columns = min(PLACES[0], height_px), min(PLACES[1], width_px)
    u = np.floor((np.arange(columns) + 0.5) * (width_px / columns) - 0.5)
    v = np.floor((np.arange(rows) + 0.5) * (height_px / rows) - 0.5)
    first = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    return np.asarray(first + PIXELS_BESIDE, np.float64)


def _shade(
    surface: Surface, points_m: FloatArray, directions: FloatArray, range_m: FloatArray
) -> float:
    """Return the share of points that the sun does not reach."""
    sky = surface.scene.sky
    if not len(points_m) or sky.lamp_w_m2 <= 0:
        return 1.0
    from_m = points_m - ABOVE_SURFACE * range_m[:, None] * directions
    to_sun = np.broadcast_to(np.array(sky.to_sun), from_m.shape)
    blocked = surface.cast(from_m, np.ascontiguousarray(to_sun), FARTHEST_M)
    return float(np.mean(blocked.targets != NO_TARGET))


def _between(bounds: tuple[float, float], value: float) -> float:
    """Return where a value is between two bounds, from 0 to 1."""
    lower, upper = bounds
    return min(max((value - lower) / (upper - lower), 0.0), 1.0)
