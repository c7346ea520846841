"""Images in physical units, and digital numbers of them, from the radiance of a view."""

from __future__ import annotations

from typing import Any, NamedTuple

from numpy.typing import NDArray

from oaisys_core.procedural.environment.radiometry import radiance_w_m2_sr
from oaisys_core.scene import PlacedCamera
from oaisys_core.scene.image_sensor import ImageSensor
from oaisys_core.scene.sky import Sky
from oaisys_core.sensing.digitizing import digitize, electrons_per_s, exposure_time_s
from oaisys_core.types import DIGITAL, RADIANCE


class LightImages(NamedTuple):
    """Images of light.

    Attributes:
        images: By modality.
        exposures: Exposure times in seconds by ``<camera>.<modality>.exposure_time_s``.
    """

    images: dict[str, NDArray[Any]]
    exposures: dict[str, float]


def light_images(
    radiance: NDArray[Any], camera: PlacedCamera, sky: Sky, noise_seed: int
) -> LightImages:
    """Return those of a camera's images that are made of the radiance that it sees.

    Args:
        radiance: (H, W, 3) in scene units.
        camera: The camera.
        sky: Says what a scene unit is.
        noise_seed: Of the noise of digital numbers.
    """
    found = LightImages({}, {})
    wanted = [each for each in camera.modalities if each in DIGITAL]
    if not wanted and RADIANCE not in camera.modalities:
        return found
    physical = radiance_w_m2_sr(radiance, sky)
    if RADIANCE in camera.modalities:
        found.images[RADIANCE] = physical
    if not wanted:
        return found
    sensor, name = _sensor_of(camera), camera.name
    rate_e_s = electrons_per_s(physical, sensor)
    for modality in wanted:
        time_s = exposure_time_s(rate_e_s, modality, sensor)
        found.images[modality] = digitize(rate_e_s, modality, sensor, time_s, noise_seed, name)
        found.exposures[f"{name}.{modality}.exposure_time_s"] = time_s
    return found


def _sensor_of(camera: PlacedCamera) -> ImageSensor:
    if camera.image_sensor is None:
        raise ValueError(f"{camera.name}: digital numbers need an image sensor")
    return camera.image_sensor
