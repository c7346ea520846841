"""How a sample's colour is rendered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from oaisys_core.sensing.effects import NO_EFFECTS, Effects
from oaisys_core.sensing.exposure import STANDARD_METER, AutoExposure

ViewTransform = Literal["agx_contrast", "agx", "filmic", "standard", "raw"]

WhiteBalance = Literal["daylight", "illuminant"]

Device = Literal["auto", "cpu", "cuda", "optix", "hip", "oneapi", "metal"]


@dataclass(frozen=True)
class RenderSettings:
    """How a sample's colour is rendered; depth and labels do not depend on it.

    Attributes:
        quality: Name of the preset, for provenance.
        samples: Samples per pixel; with a time budget, the most of them.
        max_bounces: Light bounces.
        denoise: Whether the denoiser runs after sampling.
        exposure_ev: Exposure in stops, applied before the view transform; None: each image is
            metered by ``auto_exposure``.
        seed: Seed of the light sampling.
        view_transform: Maps radiance to pixel values.
        time_budget_s: For all cameras of a sample together; None: no limit.
        passes: Modalities that may be rendered; None: all.
        effects: Lens and sensor effects, applied to colour after rendering.
        noise_seed: Seed of this sample's sensor noise.
        device: Device to render on.
        auto_exposure: How images without a fixed exposure are metered.
        white_balance: See `RenderConfig`.
        max_samples: Samples per pixel of views full of plants; others have between ``samples`` and
            so many. No more than ``samples``: all have ``samples``.
        small_samples: Samples per pixel of small images, where samples take little time beside what
            an image of any size does, four times as many with lamps; 0: as many as others have.
        clutter: Set by the backend for each view: how full it is of fine things, from 0 to 1.
    """

    quality: str
    samples: int
    max_bounces: int
    denoise: bool
    exposure_ev: float | None
    seed: int
    view_transform: ViewTransform = "agx"
    time_budget_s: float | None = None
    passes: frozenset[str] | None = None
    effects: Effects = NO_EFFECTS
    noise_seed: int = 0
    device: Device = "auto"
    auto_exposure: AutoExposure = STANDARD_METER
    white_balance: WhiteBalance = "daylight"
    max_samples: int = 0
    small_samples: int = 0
    clutter: float = 0.0

    def renders(self, modality: str) -> bool:
        """Return whether a modality of a camera may be rendered."""
        return self.passes is None or modality in self.passes

    def with_samples(self, samples: int) -> RenderSettings:
        """Return these settings with so many samples per pixel in all views."""
        return replace(self, samples=samples, max_samples=samples, small_samples=0)
