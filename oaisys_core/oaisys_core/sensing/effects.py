"""What a lens and a sensor do to a colour image after it was rendered.

Effects work on the picture as it would be shown, in linear light where 1 is its white: they know
nothing of what was brighter than that. They touch colour only, never depth or labels.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encoded, linear
from oaisys_core.geometry import pixel_rays
from oaisys_core.types import PinholeIntrinsics

Image = NDArray[np.float32]
"""(H, W, 3) linear colour."""


@dataclass(frozen=True)
class Bloom:
    """Light that bright parts spill over their surroundings.

    Attributes:
        threshold: Linear brightness from which a part spills light.
        radius_px: Standard deviation of the spill.
        strength: Share of the light above the threshold that is spilt, and added.
    """

    threshold: float
    radius_px: float
    strength: float


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a sensor whose pixels count electrons.

    Attributes:
        full_well_e: Electrons at white; their number varies by its square root (shot noise).
        read_noise_e: Standard deviation of reading a pixel out, in electrons.
    """

    full_well_e: float
    read_noise_e: float


@dataclass(frozen=True)
class Effects:
    """What is done, in this order; the defaults do nothing.

    Attributes:
        chromatic_aberration: Share by which red is magnified, and blue shrunk, about the
            principal point.
        vignetting: 1 darkens towards the corners as a thin lens does (cos⁴ of the angle off the
            axis), less does so in part.
    """

    chromatic_aberration: float = 0.0
    bloom: Bloom | None = None
    vignetting: float = 0.0
    noise: SensorNoise | None = None


NO_EFFECTS = Effects()


def with_effects(
    image_srgb: NDArray[np.uint8],
    effects: Effects,
    intrinsics: PinholeIntrinsics,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return an (H, W, 3) sRGB image with effects; the very same one without any."""
    if effects == NO_EFFECTS:
        return image_srgb
    image = linear(np.arange(256) / 255).astype(np.float32)[image_srgb]
    if effects.chromatic_aberration:
        image = _aberrated(image, effects.chromatic_aberration, intrinsics)
    if effects.bloom is not None:
        image = _bloomed(image, effects.bloom)
    if effects.vignetting:
        image = image * _falloff(intrinsics, effects.vignetting)
    if effects.noise is not None:
        image = _noisy(image, effects.noise, rng)
    return encoded(np.asarray(image, np.float64))


def _aberrated(image: Image, share: float, intrinsics: PinholeIntrinsics) -> Image:
    result = image.copy()
    height, width = image.shape[:2]
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    for channel, factor in ((0, 1 / (1 + share)), (2, 1 + share)):
        from_u = (intrinsics.cx_px + (u - intrinsics.cx_px) * factor).astype(np.float32)
        from_v = (intrinsics.cy_px + (v - intrinsics.cy_px) * factor).astype(np.float32)
        plane = np.ascontiguousarray(image[..., channel])
        result[..., channel] = cv2.remap(
            plane, from_u, from_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return result


def _bloomed(image: Image, bloom: Bloom) -> Image:
    brightness = image.max(axis=2, keepdims=True)
    over = np.maximum(brightness - bloom.threshold, 0.0) / np.maximum(brightness, 1e-6)
    spilt = cv2.GaussianBlur(image * over, (0, 0), bloom.radius_px, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(image + bloom.strength * spilt, np.float32)


def _falloff(intrinsics: PinholeIntrinsics, share: float) -> Image:
    """Return (H, W, 1) brightness."""
    cos = 1.0 / np.linalg.norm(pixel_rays(intrinsics), axis=-1, keepdims=True)
    return np.asarray(1.0 - share * (1.0 - cos**4), np.float32)


def _noisy(image: Image, noise: SensorNoise, rng: np.random.Generator) -> Image:
    """Return a noisy image; the many electrons of a pixel vary as a normal distribution does."""
    electrons = np.maximum(image, 0.0) * noise.full_well_e
    sigma = np.sqrt(electrons + noise.read_noise_e**2)
    electrons = electrons + sigma * rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(electrons / noise.full_well_e, np.float32)
