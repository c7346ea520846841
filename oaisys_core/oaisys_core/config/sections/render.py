"""Configuration of the rendering of colour images.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from oaisys_core.config.section import Positive, Section
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.types import is_rendered, modality_expectation, modality_spec

Share = Annotated[float, Field(ge=0, le=1)]


def _is_modality(name: str) -> str:
    try:
        modality_spec(name)
    except KeyError:
        raise ValueError(f"expected {modality_expectation(name)}") from None
    return name


class BloomConfig(Section):
    """Bloom: light that bright parts of the image spread over their surroundings.

    Attributes:
        threshold: Linear brightness above which a part spreads light; 1 is white.
        radius_px: Standard deviation of the spread.
        strength: Share of the light above the threshold that is spread.
    """

    threshold: Share = 0.8
    radius_px: Annotated[float, Field(gt=0, le=500)] = 8.0
    strength: Annotated[float, Field(ge=0, le=10)] = 0.5


class SensorNoiseConfig(Section):
    """Noise of an image sensor: shot noise and read noise.

    Attributes:
        full_well_e: Number of electrons at white; fewer electrons mean more shot noise.
        read_noise_e: Standard deviation of the read noise, in electrons.
    """

    full_well_e: Positive = 10_000.0
    read_noise_e: Annotated[float, Field(ge=0)] = 5.0


class EffectsConfig(Section):
    """Effects of lens and sensor on colour, applied in this order; all are off by default.

    They are applied to the finished image in linear light, in which nothing is brighter than white.

    Attributes:
        chromatic_aberration: Share by which red is magnified and blue is reduced.
        bloom: Bloom of bright parts; None for no bloom.
        vignetting: With 1 the image darkens by cos⁴ of the angle from the optical axis.
        sensor_noise: Noise drawn from the batch's seed, the sample's id and the sensor's name; None
            for no noise.
    """

    chromatic_aberration: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    bloom: BloomConfig | None = None
    vignetting: Share = 0.0
    sensor_noise: SensorNoiseConfig | None = None


class AutoExposureConfig(Section):
    """Automatic exposure of colour images, where ``exposure_ev`` is None.

    Each image is metered by itself: the mean luminance of ground and objects becomes ``target``.
    The sky counts little, and only ``bright_share`` of the image may be brighter than white.

    Attributes:
        target: Linear value of the mean luminance before the view transform. The default is shown
            as about 128 of 255, half a stop above mid-grey (0.18).
        compensation_ev: Stops that are added to the metered exposure.
        min_ev, max_ev: Limits in stops, as of ``exposure_ev``. At the default upper limit, a camera
            that needs 0.5 ms at noon exposes for 33 ms with a gain of 12 dB; nights stay dark.
        bright_share: Share of the image that may be brighter than white; it darkens an image by at
            most 2 stops, and by at most 1 if only the sky is as bright.
        albedo_share: How far the brightness of the ground itself shows. 0 exposes black sand and
            snow alike, as reflected-light meters do; 1 shows them as different as they are, as
            incident-light meters do. Ground with a mean albedo of 0.2 is exposed alike by both.
    """

    target: Annotated[float, Field(gt=0, le=1)] = 0.25
    compensation_ev: float = Field(default=0.0, ge=-10, le=10)
    min_ev: float = Field(default=-6.0, ge=-20, le=20)
    max_ev: float = Field(default=8.0, ge=-20, le=20)
    bright_share: Share = 0.02
    albedo_share: Share = 0.5

    @model_validator(mode="after")
    def _limits_in_order(self) -> AutoExposureConfig:
        if self.min_ev > self.max_ev:
            raise ValueError(f"expected min_ev {self.min_ev:g} below max_ev {self.max_ev:g}")
        return self


class RenderConfig(Section):
    """Rendering of colour images; depth and labels are exact at every quality.

    Attributes:
        quality: Preset of samples per pixel and bounces. ``geometry`` renders no colour. ``draft``
            shades the rays that depth is cast with, in a fraction of a second and without noise;
            samples, bounces, denoising, depth of field and motion blur do not matter to it.
        samples: Samples per pixel; None for those of the preset: 1 in ``preview``, or 6 in images
            of up to 64×48 pixels, 3 in ``standard``, 8 in ``high``, 128 in ``final``. With lamps
            or ground that has gloss, such as mud, images of up to 64×48 pixels have 24, but in
            ``final``.
        max_samples: Samples per pixel of views full of plants. Views have between ``samples`` and
            so many, by how much of them shows fine things such as leaves, or is in shade; images
            of up to 64×48 pixels have so many at once. None for that of the preset (6 in
            ``standard``, whose open ground has 3), or for ``samples`` if that is set. The
            provenance of a sample has the number.
        denoise: Whether the colour image is denoised.
        max_bounces: Largest number of light bounces; None for that of the preset.
        time_budget_s: Seconds that all cameras of a sample may take together; None for no limit.
            Sampling stops when the time is over, or at the samples per pixel that the view would
            have without a limit. The quality of the denoising depends on the remaining time. If a
            single sample per pixel takes too long, colour is rendered at a lower resolution and
            enlarged. The time of all other work is estimated from recent views; the first view has
            one sample per pixel. With a time budget colour depends on the machine; depth and labels
            never do.
        device: Device on which Blender renders. ``auto`` uses a GPU if there is one. If a device is
            not available, the CPU is used and the log has a warning. The provenance of a sample
            names the device that was used. The analytic backend always uses the CPU.
        exposure_ev: Fixed exposure in stops; None meters each colour image, see
            ``auto_exposure``. The provenance of a sample has the exposure of each camera.
        auto_exposure: How colour images are metered.
        white_balance: ``daylight`` shows white sunlight as white, as a camera set to daylight:
            close to neutral at noon on Earth, warm at a low sun, butterscotch on Mars.
            ``illuminant`` is neutral under the world's own light: a grey card on level ground is
            grey under its sun and sky, on Earth at any hour and on Mars; at night and under a sky
            image, under its sky and lamps.
        view_transform: Conversion from radiance to pixel values. ``agx`` and ``filmic`` compress
            highlights like film; ``agx_contrast`` has the contrast of a camera's pictures beside;
            ``standard`` clips radiance at white and encodes it as sRGB, so
            that linear values are proportional to light; ``raw`` is the same without the encoding.
            Without Blender, ``draft`` approximates those of film (within 1.4 of 255 for 95 % of
            the values), and all other qualities of the analytic backend use ``standard``.
        passes: Modalities to render, out of those of the sensors; None for all. Each must be one of
            some camera, and no colour with the quality ``geometry``.
        camera_look: Preset of ``effects``, each of which replaces that of the preset.
            ``clean`` has none. ``machine_vision`` is an industrial camera with a small lens:
            vignetting 0.6, chromatic aberration 0.0004, and the noise of a sensor with a full well
            of 10,500 and a read noise of 2.5 electrons. ``mars_mastcam_like`` is a science camera
            behind a dusty window: vignetting 0.3, bloom (threshold 0.85, radius 6 px, strength
            0.15), 26,000 and 18 electrons (after Bell et al. 2017).
        effects: Effects of lens and sensor on colour.
    """

    quality: Literal["geometry", "draft", "preview", "standard", "high", "final"] = "standard"
    samples: Annotated[int, Field(ge=1, le=65536)] | None = None
    max_samples: Annotated[int, Field(ge=1, le=65536)] | None = None
    denoise: bool = True
    max_bounces: Annotated[int, Field(ge=0, le=64)] | None = None
    time_budget_s: Positive | None = None
    device: Literal["auto", "cpu", "cuda", "optix", "hip", "oneapi", "metal"] = "auto"
    exposure_ev: float | None = Field(default=None, ge=-20, le=20)
    auto_exposure: AutoExposureConfig = AutoExposureConfig()
    view_transform: Literal["agx_contrast", "agx", "filmic", "standard", "raw"] = "agx_contrast"
    white_balance: Literal["daylight", "illuminant"] = "daylight"
    passes: tuple[Annotated[str, AfterValidator(_is_modality)], ...] | None = None
    camera_look: Literal["clean", "machine_vision", "mars_mastcam_like"] = "clean"
    effects: EffectsConfig = EffectsConfig()

    @model_validator(mode="after")
    def _samples_in_order(self) -> RenderConfig:
        if self.samples and self.max_samples and self.samples > self.max_samples:
            received = f"max_samples: received {self.max_samples}"
            raise ValueError(f"{received}, expected {self.samples} or more, as samples says")
        return self

    def renders(self, modality: str) -> bool:
        """Return whether samples have the images that a camera has of a modality."""
        return is_rendered(modality, self.quality, self.passes)

    def check_passes(self, offered: Collection[str], path: str) -> None:
        """Raise if an image that is asked for would not be rendered, or no image at all.

        Args:
            offered: Modalities of all sensors of the rig.
            path: Path of this section.

        Raises:
            InvalidInputError: Names the pass, or the quality.
        """
        for index, name in enumerate(self.passes or ()):
            if name not in offered:
                expected = f"{one_of(offered, name)}: the modalities of the sensors"
                raise InvalidInputError(f"{path}.passes.{index}", name, expected)
            if not self.renders(name):
                expected = f"no colour, because render.quality is {self.quality}"
                raise InvalidInputError(f"{path}.passes.{index}", name, expected)
        if not any(self.renders(name) for name in offered):
            field = "quality" if self.passes is None else "passes"
            received = self.model_dump(mode="json")[field]
            expected = f"one that renders something of {', '.join(sorted(offered))}"
            raise InvalidInputError(f"{path}.{field}", received, expected)
