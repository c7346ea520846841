"""How colour is rendered.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from oaisys_core.config.section import Positive, Section
from oaisys_core.types import expected_modality, modality_spec

Share = Annotated[float, Field(ge=0, le=1)]


def _is_modality(name: str) -> str:
    try:
        modality_spec(name)
    except KeyError:
        raise ValueError(f"expected {expected_modality(name)}") from None
    return name


class BloomConfig(Section):
    """Light that bright parts spill over their surroundings.

    Attributes:
        threshold: Linear brightness, 1 is white, from which a part spills light.
        radius_px: Standard deviation of the spill.
        strength: Share of the light above the threshold that is added around it.
    """

    threshold: Share = 0.8
    radius_px: Annotated[float, Field(gt=0, le=500)] = 8.0
    strength: Annotated[float, Field(ge=0, le=10)] = 0.5


class SensorNoiseConfig(Section):
    """Noise of a sensor whose pixels count electrons.

    Attributes:
        full_well_e: Electrons at white; the fewer, the more shot noise.
        read_noise_e: Standard deviation of reading a pixel out, in electrons.
    """

    full_well_e: Positive = 10_000.0
    read_noise_e: Annotated[float, Field(ge=0)] = 5.0


class EffectsConfig(Section):
    """What a lens and a sensor do to colour; all off by default, and in this order.

    They work on the finished picture, in linear light: nothing in it is brighter than white.

    Attributes:
        chromatic_aberration: Share by which red is magnified, and blue shrunk.
        bloom: None: none.
        vignetting: 1 darkens towards the corners by cos⁴ of the angle off the axis.
        sensor_noise: Drawn from the batch's seed, the sample's id and the sensor's name; None:
            none.
    """

    chromatic_aberration: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    bloom: BloomConfig | None = None
    vignetting: Share = 0.0
    sensor_noise: SensorNoiseConfig | None = None


class RenderConfig(Section):
    """How colour is rendered; depth and labels are exact at every quality.

    Attributes:
        quality: Preset of samples per pixel and bounces; ``geometry`` renders no colour at all.
        samples: Light samples per pixel; None: the preset's.
        denoise: Whether the denoiser runs after sampling.
        max_bounces: Bounces of light; None: the preset's.
        time_budget_s: Seconds that a sample may take, all its cameras together. Light samples are
            taken until it is over, at most those of ``quality`` or ``samples``: with ``final`` the
            time is used up, and denoised as thoroughly as the time that they leave allows. Where
            one sample of each pixel takes too long, colour is rendered with fewer pixels and
            enlarged. What comes before and after is judged by recent views; the first view has one
            light sample. Such colour depends on the machine; depth and labels never do. None: as
            long as it takes.
        device: What Blender renders on. ``auto`` takes a GPU where there is one; a kind that is not
            there is replaced by the CPU, with a warning in the log. The provenance of a sample
            names what was used. The analytic backend always renders on the CPU.
        exposure_ev: Exposure in stops.
        view_transform: What pixel values mean. ``agx`` and ``filmic`` roll bright parts off as
            film does, for pictures; ``standard`` is radiance, clipped at white and sRGB-encoded,
            so that linear values are proportional to light; ``raw`` is the same without the sRGB
            encoding. The analytic backend always renders ``standard``.
        passes: Modalities to render of those that the sensors have, for all of them; None: all.
        effects: What a lens and a sensor do to colour.
    """

    quality: Literal["geometry", "preview", "standard", "high", "final"] = "standard"
    samples: Annotated[int, Field(ge=1, le=65536)] | None = None
    denoise: bool = True
    max_bounces: Annotated[int, Field(ge=0, le=64)] | None = None
    time_budget_s: Positive | None = None
    device: Literal["auto", "cpu", "cuda", "optix", "hip", "oneapi", "metal"] = "auto"
    exposure_ev: float = Field(default=0.0, ge=-20, le=20)
    view_transform: Literal["agx", "filmic", "standard", "raw"] = "agx"
    passes: tuple[Annotated[str, AfterValidator(_is_modality)], ...] | None = None
    effects: EffectsConfig = EffectsConfig()
