"""Configuration of a camera's image sensor, for images of digital numbers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from oaisys_core.config.section import Positive, Section
from oaisys_core.scene.image_sensor import ImageSensor

BLACK_LEVEL_SHARE = 64
"""The range of numbers divided by a usual black level."""

Efficiency = Annotated[float, Field(ge=0, le=1)]
Seconds = Annotated[float, Field(ge=1e-9, le=1e4)]


class ImageSensorConfig(Section):
    """How light becomes digital numbers (DN), by the model and the names of EMVA 1288.

    It counts for the modalities ``mono16``, ``rgb16`` and ``bayer_*16``. The defaults are those of
    a global-shutter sensor of 2/3 inch behind a lens at f/4.

    Attributes:
        exposure_time_s: Time for which a pixel collects light; ``auto``: metered for each image by
            itself.
        min_exposure_s, max_exposure_s: Limits of the metered time.
        target: Mean of the image that the meter aims at, as a share of the range of numbers; it
            lets 1 % of the pixels saturate.
        f_number: Focal length divided by the diameter of the aperture.
        transmission: Share of light that the lens lets through.
        pixel_pitch_um: Edge length of a pixel, all of which collects light.
        quantum_efficiency: Electrons per photon in red, green and blue, filters included; of
            ``mono16`` the bands are summed.
        full_well_e: Electrons that a pixel holds.
        dark_current_e_s: Electrons per second without light.
        read_noise_e: Standard deviation of reading a pixel out, in electrons.
        prnu, dsnu_e: Standard deviations of the pixels' own gain, relative, and of their own
            offset, in electrons; they are the same in all images of a camera.
        gain_dn_e: Overall system gain K, in DN per electron; None: a full well is the largest
            number.
        black_level_dn: Number of a pixel without electrons; None: 1/64 of the range.
        bits: Of a number; images have 16 bits in any case.
        blur_px: Standard deviation of the point spread function of lens and pixel.
    """

    exposure_time_s: Seconds | Literal["auto"] = "auto"
    min_exposure_s: Seconds = 1e-5
    max_exposure_s: Seconds = 1.0
    target: float = Field(default=0.25, ge=0.001, le=1)
    f_number: float = Field(default=4.0, ge=0.1, le=1000)
    transmission: float = Field(default=0.9, gt=0, le=1)
    pixel_pitch_um: float = Field(default=3.45, ge=0.1, le=1000)
    quantum_efficiency: tuple[Efficiency, Efficiency, Efficiency] = (0.5, 0.6, 0.5)
    full_well_e: float = Field(default=10_500.0, ge=1, le=1e9)
    dark_current_e_s: float = Field(default=1.0, ge=0, le=1e6)
    read_noise_e: float = Field(default=2.4, ge=0, le=1e6)
    prnu: float = Field(default=0.004, ge=0, le=1)
    dsnu_e: float = Field(default=0.7, ge=0, le=1e6)
    gain_dn_e: Positive | None = None
    black_level_dn: Annotated[float, Field(ge=0, le=65535)] | None = None
    bits: Literal[8, 10, 12, 14, 16] = 12
    blur_px: float = Field(default=0.0, ge=0, le=100)

    @model_validator(mode="after")
    def _in_order(self) -> ImageSensorConfig:
        if self.min_exposure_s > self.max_exposure_s:
            raise ValueError(
                f"max_exposure_s: expected min_exposure_s ({self.min_exposure_s:g}) or more,"
                f" received {self.max_exposure_s:g}"
            )
        if (self.black_level_dn or 0) >= 2**self.bits - 1:
            raise ValueError(
                f"black_level_dn: expected less than {2**self.bits - 1}, the largest number of"
                f" {self.bits} bits, received {self.black_level_dn:g}"
            )
        return self

    @property
    def image_sensor(self) -> ImageSensor:
        """The image sensor."""
        time_s = self.exposure_time_s
        values = self.model_dump(
            exclude={"exposure_time_s", "min_exposure_s", "max_exposure_s", "pixel_pitch_um"}
        )
        if self.black_level_dn is None:
            values["black_level_dn"] = 2**self.bits / BLACK_LEVEL_SHARE
        return ImageSensor(
            exposure_time_s=None if isinstance(time_s, str) else time_s,
            exposure_limits_s=(self.min_exposure_s, self.max_exposure_s),
            pixel_pitch_m=self.pixel_pitch_um * 1e-6,
            **values,
        )
