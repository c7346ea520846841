"""OpenEXR images: 32-bit floats, which PNG does not hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, RenderError

GREY = "Y"
"""Channel of a single-channel image."""


def write_grey(path: Path, image: NDArray[np.float32]) -> None:
    """Write an (H, W) float32 image without loss; inverse: `read_channels`.

    Raises:
        RenderError: It could not be written.
    """
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {GREY: np.ascontiguousarray(image, np.float32)}
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except (OSError, RuntimeError) as error:
        raise RenderError(f"{path}: could not be written: {error}") from error


def read_channels(path: Path) -> dict[str, NDArray[Any]]:
    """Return the (H, W) channels of an image by name.

    Raises:
        InvalidInputError: It cannot be read.
    """
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
    except (OSError, RuntimeError) as error:
        raise InvalidInputError("image", str(path), f"a readable EXR image ({error})") from error
