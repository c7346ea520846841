"""A camera's image sensor, by the quantities of EMVA 1288."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ImageSensor:
    """How light becomes digital numbers (DN); names and model after EMVA 1288, release 4.0 Linear.

    Attributes:
        exposure_time_s: Time for which a pixel collects light; None: metered for each image.
        exposure_limits_s: Shortest and longest time that the meter chooses.
        target: Mean of the image that the meter aims at, as a share of the range of numbers.
        f_number: Focal length divided by the diameter of the aperture.
        transmission: Share of light that the lens lets through.
        pixel_pitch_m: Edge length of a pixel, all of which collects light.
        quantum_efficiency: Electrons per photon in red, green and blue, filters included; of a
            monochrome sensor their sum counts.
        full_well_e: Electrons that a pixel holds.
        dark_current_e_s: Electrons per second without light.
        read_noise_e: Standard deviation of reading a pixel out, in electrons.
        prnu, dsnu_e: Standard deviations of the pixels' own gain, relative, and of their own
            offset, in electrons; the same in all images of a camera.
        gain_dn_e: Overall system gain K; None: a full well is the largest number.
        black_level_dn: Number of a pixel without electrons.
        bits: Of a number.
        blur_px: Standard deviation of the point spread function of lens and pixel.
    """

    exposure_time_s: float | None
    exposure_limits_s: tuple[float, float]
    target: float
    f_number: float
    transmission: float
    pixel_pitch_m: float
    quantum_efficiency: tuple[float, float, float]
    full_well_e: float
    dark_current_e_s: float
    read_noise_e: float
    prnu: float
    dsnu_e: float
    gain_dn_e: float | None
    black_level_dn: float
    bits: int
    blur_px: float

    @property
    def white_dn(self) -> int:
        """The largest number."""
        return int(2**self.bits - 1)

    @property
    def gain(self) -> float:
        """Overall system gain K, in DN per electron."""
        if self.gain_dn_e is not None:
            return self.gain_dn_e
        return (self.white_dn - self.black_level_dn) / self.full_well_e
