"""Changes to a configuration by options of the command line."""

from __future__ import annotations

import re
from typing import Any

from pydantic import ValidationError

from oaisys_core.config.expectations import refusal
from oaisys_core.config.model import SimulationConfig
from oaisys_core.config.sections.sensing.cameras import CameraConfig
from oaisys_core.errors import InvalidInputError


def adjust(
    config: SimulationConfig,
    *,
    seed: int | None = None,
    backend: str | None = None,
    quality: str | None = None,
    size: str | None = None,
) -> SimulationConfig:
    """Return the configuration with all given values replaced, and checked again.

    Args:
        config: The configuration before the changes.
        seed: Root seed.
        backend: ``blender`` or ``analytic``.
        quality: Quality preset; it also resets ``samples``, ``max_samples`` and
            ``max_bounces``.
        size: Image size of all cameras as ``WIDTHxHEIGHT``; K is scaled by the width, so that the
            horizontal field of view and the shape of the pixels stay the same.

    Raises:
        InvalidInputError: Names the option, the value and what was expected.
    """
    data: dict[str, Any] = config.model_dump()
    if seed is not None:
        data["seed"] = seed
    if backend is not None:
        data["backend"] = backend
    if quality is not None:
        data["render"].update(quality=quality, samples=None, max_samples=None, max_bounces=None)
    if size is not None:
        size_px = _parse(size)
        for kind in ("cameras", "stereo"):
            cameras = getattr(config.sensors, kind)
            data["sensors"][kind] = [_resize(camera, *size_px) for camera in cameras]
    try:
        return SimulationConfig.model_validate(data)
    except ValidationError as error:
        raise refusal(error, data, SimulationConfig) from error


def _parse(size: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,5})x([1-9]\d{0,5})", size)
    if match is None:
        raise InvalidInputError("size", size, "WIDTHxHEIGHT in pixels, such as 320x240")
    return int(match[1]), int(match[2])


def _resize(camera: CameraConfig, width_px: int, height_px: int) -> dict[str, Any]:
    x, y = width_px / camera.width_px, height_px / camera.height_px
    # Pixel centres are at integers, so an image extends from -0.5 to size - 0.5.
    cx_px = None if camera.cx_px is None else (camera.cx_px + 0.5) * x - 0.5
    cy_px = None if camera.cy_px is None else (camera.cy_px + 0.5) * y - 0.5
    return {
        **camera.model_dump(),
        "width_px": width_px,
        "height_px": height_px,
        "fx_px": camera.fx_px * x,
        "fy_px": camera.fy_px * x,
        "cx_px": cx_px,
        "cy_px": cy_px,
    }
