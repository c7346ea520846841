"""Effects of a lens and a sensor on a rendered colour image.

Effects are applied to the final image in linear light, where 1 is white and nothing is brighter.
They change colour only, never depth or labels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb, linear
from oaisys_core.geometry import pixel_rays
from oaisys_core.types import PinholeIntrinsics

Image = NDArray[np.float32]
"""(H, W, 3) linear colour."""


@dataclass(frozen=True)
class Bloom:
    """Light of bright areas that spreads over their surroundings.

    Attributes:
        threshold: Linear brightness above which light spreads.
        radius_px: Standard deviation of the spread.
        strength: Share of the light above the threshold that is spread, and added to the image.
    """

    threshold: float
    radius_px: float
    strength: float


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a sensor whose pixels count electrons.

    Attributes:
        full_well_e: Number of electrons at white; it varies by its square root (shot noise).
        read_noise_e: Standard deviation of the read-out of a pixel, in electrons.
    """

    full_well_e: float
    read_noise_e: float


@dataclass(frozen=True)
class Effects:
    """The effects, in the order in which they are applied; none by default.

    Attributes:
        chromatic_aberration: Share by which red is magnified and blue is shrunk about the
            principal point.
        vignetting: Strength of the darkening towards the corners; 1 is that of a thin lens (cos⁴
            of the angle to the axis).
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
    """Return an (H, W, 3) sRGB image with effects; the same object if there are none."""
    if effects == NO_EFFECTS:
        return image_srgb
    image = linear(np.arange(256) / 255).astype(np.float32)[image_srgb]
    if effects.chromatic_aberration:
        image = _aberrate(image, effects.chromatic_aberration, intrinsics)
    if effects.bloom is not None:
        image = _bloom(image, effects.bloom)
    if effects.vignetting:
        image = image * _falloff(intrinsics, effects.vignetting)
    if effects.noise is not None:
        image = _noisy(image, effects.noise, rng)
    return encode_srgb(np.asarray(image, np.float64))


def _aberrate(image: Image, share: float, intrinsics: PinholeIntrinsics) -> Image:
    import cv2

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


def _bloom(image: Image, bloom: Bloom) -> Image:
    import cv2

    brightness = image.max(axis=2, keepdims=True)
    over = np.maximum(brightness - bloom.threshold, 0.0) / np.maximum(brightness, 1e-6)
    spilt = cv2.GaussianBlur(image * over, (0, 0), bloom.radius_px, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(image + bloom.strength * spilt, np.float32)


def _falloff(intrinsics: PinholeIntrinsics, share: float) -> Image:
    """Return (H, W, 1) brightness."""
    rays = pixel_rays(intrinsics)
    # A fisheye may see behind itself.
    cos = np.maximum(rays[..., 2:], 0.0) / np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.asarray(1.0 - share * (1.0 - cos**4), np.float32)


def _noisy(image: Image, noise: SensorNoise, rng: np.random.Generator) -> Image:
    """Return a noisy image; the Poisson noise of many electrons is approximated by a normal one."""
    electrons = np.maximum(image, 0.0) * noise.full_well_e
    sigma = np.sqrt(electrons + noise.read_noise_e**2)
    electrons = electrons + sigma * rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(electrons / noise.full_well_e, np.float32)
