"""What is done to radiance after Cycles: denoising, and the rest of the pixel filter.

What is denoised is light: radiance is divided by the albedo that the same samples have seen, and
multiplied by it afterwards, so that denoising does not blur textures. On the ground, it is
multiplied by the albedo of `GroundAlbedo`, which has no noise. Cycles follows samples that water
and ice reflect to the sky or the rock in the mirror, and its albedo and normals for denoising are
those of either, by chance. In such views, they are those of the first surface instead.

Where the library that denoises cannot be called, Cycles denoises radiance itself.

The pixel filter of denoised images has two steps. Cycles filters by the position of samples in a
pixel and puts the first one at the centre, so that each sample serves one pixel only. Filters that
share samples between pixels leave less noise (Pharr, Jakob and Humphreys, Physically Based
Rendering, 3rd edition, 7.8): Cycles samples with a narrow filter, and the rest is a convolution.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.private.open_image_denoise import (
    QUALITY_BALANCED,
    QUALITY_FAST,
    OpenImageDenoise,
    blenders_open_image_denoise,
)
from oaisys_core.render.blender.compat import DIFFUSE_COLOR, GLOSSY_COLOR, MATERIAL_INDEX
from oaisys_core.render.blender.materials.ground.albedo import PixelAlbedo
from oaisys_core.render.blender.materials.ground.narrow_patches import (
    MOST_SAMPLES,
    Patches,
    share_albedo,
)
from oaisys_core.render.blender.materials.surfaces import BY_CHANCE, GROUND
from oaisys_core.render.blender.time_budget import DenoisingQuality
from oaisys_core.render.render_result import Image, RenderResult, pass_of
from oaisys_core.sensing.render_settings import RenderSettings

CYCLES_WIDTH_PX = 1.5
"""Blender's default filter width, for images that are not denoised; the Blackman-Harris window is
twice as wide."""

SAMPLED_WIDTH_PX = 0.75
"""Filter width of Cycles for images that are denoised."""

SHARE = 0.065
"""Weight of each neighbour in the convolution: the two steps together are then as wide as Cycles'
own filter."""

NOISY_SHARE = 0.08
"""The same weight for a single sample per pixel."""

MANY_SAMPLES = 8
"""Samples per pixel from which on denoising and interpolation smear less."""

SMEARED_OF_FEW, SMEARED = (0.015, 0.04), (0.005, 0.04)
"""By how much the weight is less on open ground and in views full of plants, because denoising and
interpolation of texels (`TEXEL_PX`) have smeared their finest detail: with fewer samples per pixel
than `MANY_SAMPLES`, and with so many. Of still more, denoising smears less."""

NORMAL_SHARE = 0.08
"""The same weight for the normals that guide the denoiser."""

MIN_ALBEDO = np.float32(0.01)
"""Added to the albedo that radiance is divided by."""

ALBEDO_SHARE, EDGE_SHARE = 0.12, 0.25
"""The same weight for smoothed albedo, and for the normals whose mean length shows edges."""

SMOOTHED, EDGE_GAIN = 0.3, 6
"""Share of smoothed albedo on even ground, less with more than `MANY_SAMPLES`, and how fast it
grows as that length falls below 1."""

CONFIRMED_PX, MAX_DIFFERENCE = 15, 0.03
"""Edge length of the square over which an albedo without noise must be that of the samples, and how
much it may differ, as a share."""

MIRROR_SHARE = 0.1
"""Share of light that a film reflects from which on Cycles may take dark ground for a mirror: where
the film has three quarters of all weight."""

DEPTH = "Depth"
"""Blender's name of the pass with the depth of the first sample."""

BACKGROUND_M = 1e9
"""Cycles gives a larger depth where nothing was hit."""

COMBINED, SEEN_ALBEDO, SEEN_NORMAL = "Combined", "Denoising Albedo", "Denoising Normal"
"""Blender's names of the passes with radiance, and with albedo and normals for the denoiser."""

NORMAL = "Normal"
"""Blender's name of the pass with the normals of the first surface; they are in ``map``."""


def denoise_image(
    rendered: RenderResult,
    settings: RenderSettings,
    denoiser: Denoiser | None,
    denoising: DenoisingQuality,
    ground: PixelAlbedo | None = None,
    patches: Patches | None = None,
) -> Image:
    """Return the (H, W, 3 or 4) radiance of a render, denoised if the settings say so.

    Args:
        rendered: With the passes for denoising.
        settings: Of the render.
        denoiser: None if Cycles has denoised it.
        denoising: See `Denoiser.denoise`.
        ground: Albedo without noise, where it is known; the samples' own is used elsewhere.
        patches: The ground's; None if neighbours shall not share albedo.
    """
    radiance = pass_of(rendered, COMBINED)
    if not settings.denoise:
        return radiance
    radiance = radiance[..., :3]
    if denoiser is not None:
        seen = pass_of(rendered, SEEN_ALBEDO)
        samples = rendered.samples_per_pixel(settings)
        divisor, normal = _guides(rendered, denoiser, denoising, samples)
        albedo = divisor
        if ground is not None:
            is_clean = _is_confirmed(ground, seen)[..., None]
            divisor = np.where(is_clean, seen + MIN_ALBEDO, divisor)
            albedo = np.where(is_clean, ground.linear + MIN_ALBEDO, albedo)
        if patches is not None and samples <= MOST_SAMPLES:
            shared, share = _shared(rendered, seen, patches, samples)
            divisor = divisor + share * (seen + MIN_ALBEDO - divisor)
            albedo = albedo + share * (shared + MIN_ALBEDO - albedo)
        radiance = albedo * denoiser.denoise(radiance / divisor, normal, denoising)
    return filter_denoised(radiance, rendered.samples_per_pixel(settings), settings.clutter)


def _shared(
    rendered: RenderResult, seen: Image, patches: Patches, samples: int
) -> tuple[Image, Image]:
    """Return `share_albedo` of ground that is no mirror."""
    is_ground = pass_of(rendered, MATERIAL_INDEX)[..., 0] == GROUND
    is_dull = _sum_of_channels(pass_of(rendered, GLOSSY_COLOR)) <= 3 * MIRROR_SHARE
    depth_m = pass_of(rendered, DEPTH)[..., 0]
    return share_albedo(seen, depth_m, is_ground & is_dull, patches, samples)


def _guides(
    rendered: RenderResult, denoiser: Denoiser, denoising: DenoisingQuality, samples: int
) -> tuple[Image, Image]:
    """Return the (H, W, 3) albedo to divide radiance by, and the denoiser's (H, W, 3) normals."""
    reflected = _convolve(_sum_of_channels(pass_of(rendered, GLOSSY_COLOR)) / 3, 1 / 3)
    is_water = pass_of(rendered, MATERIAL_INDEX)[..., 0] == BY_CHANCE
    if not (is_water.any() or (reflected > MIRROR_SHARE).any()):
        normal = pass_of(rendered, SEEN_NORMAL)
        albedo = pass_of(rendered, SEEN_ALBEDO)
        return _divisor(albedo, normal, _sky_share(albedo, normal), samples), normal
    normal = pass_of(rendered, NORMAL)
    is_film = is_water | (reflected > 0)
    albedo = _albedo_of_films(rendered, is_film)
    # The sky's albedo of 0 would bleed over its border.
    is_sky = pass_of(rendered, DEPTH) >= BACKGROUND_M
    surface = np.where(is_sky, albedo[is_film].mean(axis=0), albedo)
    smooth = denoiser.denoise_albedo(surface) + MIN_ALBEDO
    # Beside the sky, a film's smooth albedo has no share for the sky in the same pixel.
    sky = _sky_share(albedo, normal)
    is_within = is_film[..., None] & (sky == 0)
    divisor = np.where(is_within, smooth, _divisor(albedo, normal, sky, samples))
    if denoising != "thorough":
        normal = denoiser.denoise_normal(normal)
    return divisor, normal


def _albedo_of_films(rendered: RenderResult, is_film: NDArray[np.bool_]) -> Image:
    """Return (H, W, 3) albedo, and beside it what films reflect, compared with diffuse light.

    Sky in a mirror may be as bright as ground under it, or far darker than ground in the sun. The
    brightness of both, which radiance divided by this albedo has in common, is fitted to all films.
    """
    diffuse, glossy = pass_of(rendered, DIFFUSE_COLOR), pass_of(rendered, GLOSSY_COLOR)
    radiance = pass_of(rendered, COMBINED)[..., :3]
    parts = np.stack([each[is_film].sum(axis=-1) for each in (diffuse, glossy)], axis=-1)
    light = radiance[is_film].sum(axis=-1)
    (of_diffuse, of_glossy), *_ = np.linalg.lstsq(parts.astype(np.float64), light, rcond=None)
    ratio = np.clip(of_glossy / of_diffuse, 0, 1) if of_diffuse > 0 else 1.0
    return np.asarray(diffuse + np.float32(ratio) * glossy, np.float32)


def _divisor(albedo: Image, normal: Image, sky: Image, samples: int) -> Image:
    """Return the (H, W, 3) albedo to divide radiance by: 1 for the sky, and nowhere 0.

    It is smoothed most where normals turn within a pixel or two, as at edges and in foliage,
    because few samples per pixel are not enough there.
    """
    albedo, normal = np.ascontiguousarray(albedo), np.ascontiguousarray(normal)
    length = _length(_convolve(normal, EDGE_SHARE))
    least = SMOOTHED * MANY_SAMPLES / max(samples, MANY_SAMPLES)
    smoothed = np.clip(least + EDGE_GAIN * (1 - length), 0, 1).astype(np.float32)
    albedo = albedo + sky
    mixed = albedo + smoothed[..., None] * (_convolve(albedo, ALBEDO_SHARE) - albedo)
    return np.asarray(mixed + MIN_ALBEDO, np.float32)


def _is_confirmed(ground: PixelAlbedo, seen: Image) -> NDArray[np.bool_]:
    """Return the (H, W) pixels around which a known albedo is on average what samples have seen."""
    size = CONFIRMED_PX, CONFIRMED_PX
    known = ground.is_known.astype(np.float32)
    difference = cv2.blur((ground.linear - seen) * known[..., None], size)
    level = cv2.blur(seen * known[..., None], size)
    few_percent = MAX_DIFFERENCE * (level + MIN_ALBEDO * cv2.blur(known, size)[..., None])
    return np.asarray(ground.is_known & (np.abs(difference) <= few_percent).all(axis=-1))


def _sky_share(albedo: Image, normal: Image) -> Image:
    """Return the (H, W, 1) share of the sky in pixels of the sky and beside them.

    There, the length of the mean normal is about the share of surfaces.
    """
    is_sky = _sum_of_channels(np.abs(albedo) + np.abs(normal)) == 0
    near_sky = cv2.dilate(is_sky.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    surface = np.minimum(_length(normal), 1)
    return np.asarray(np.where(near_sky, 1 - surface, 0)[..., None], np.float32)


def _length(vectors: Image) -> Image:
    """Return the (H, W) lengths of (H, W, 3) vectors."""
    return np.sqrt(_sum_of_channels(vectors * vectors))


def _sum_of_channels(image: Image) -> Image:
    # NumPy takes ten times as long for sums over a short last axis.
    return np.asarray(cv2.transform(image, np.ones((1, 3), np.float32)), np.float32)


class Denoiser:
    """Denoises images on the CPU, by Open Image Denoise."""

    def __init__(self, library: OpenImageDenoise) -> None:
        self._library = library

    def denoise(self, light: Image, normal: Image, denoising: DenoisingQuality) -> Image:
        """Return (H, W, 3) denoised light.

        Args:
            light: (H, W, 3) radiance divided by albedo.
            normal: (H, W, 3) normals that the same samples have seen.
            denoising: ``fast`` uses a smaller network than ``balanced``, in half the time;
                ``thorough`` denoises the normals first, which otherwise are only filtered.

        Raises:
            OaisysError: The image is no longer wanted.
            RenderError: The library failed.
            ValueError: The normals have another shape.
        """
        if normal.shape != light.shape:
            raise ValueError(f"normal: received {normal.shape} beside light {light.shape}")
        is_thorough = denoising == "thorough"
        normal = self.denoise_normal(normal) if is_thorough else filter_normal(normal)
        # The library takes normals only together with an albedo.
        images = {b"color": light, b"albedo": np.ones_like(light), b"normal": normal}
        quality = QUALITY_FAST if denoising == "fast" else QUALITY_BALANCED
        # Without cleanAux, it would blur edges and relief as if the normals were noisy.
        return self._library.filter(images, quality, hdr=True, cleanAux=True)

    def denoise_albedo(self, albedo: Image) -> Image:
        """Return (H, W, 3) denoised albedo; for errors see `denoise`."""
        return self._library.filter({b"albedo": albedo}, QUALITY_BALANCED)

    def denoise_normal(self, normal: Image) -> Image:
        """Return (H, W, 3) denoised normals; for errors see `denoise`."""
        return self._library.filter({b"normal": normal}, QUALITY_FAST)


@cache
def blenders_denoiser() -> Denoiser | None:
    """Return the denoiser that Blender has loaded; None if it cannot be used: Cycles denoises."""
    library = blenders_open_image_denoise()
    return None if library is None else Denoiser(library)


def filter_denoised(
    radiance: NDArray[np.float32], samples: int, clutter: float = 0.0
) -> NDArray[np.float32]:
    """Return a denoised (H, W, 3) image after the second step of the pixel filter.

    Args:
        radiance: The image.
        samples: Samples per pixel that it was rendered with.
        clutter: See `RenderSettings`.
    """
    if samples <= 1:
        return _convolve(radiance, NOISY_SHARE)
    open_ground, plants = SMEARED if samples >= MANY_SAMPLES else SMEARED_OF_FEW
    less = (open_ground + clutter * (plants - open_ground)) * min(1.0, MANY_SAMPLES / samples)
    return _convolve(radiance, SHARE - less)


def filter_normal(normal: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (H, W, 3) normals, smoothed a little so that the denoiser may rely on them."""
    return _convolve(normal, NORMAL_SHARE)


def _convolve(image: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    kernel = np.array([share, 1 - 2 * share, share], np.float32)
    whole = np.ascontiguousarray(image)
    filtered = cv2.sepFilter2D(whole, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(filtered, dtype=np.float32)
