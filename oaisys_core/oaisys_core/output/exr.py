"""OpenEXR images with 32-bit floats."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, RenderError

GREY = "Y"
"""Name of the channel of a single-channel image."""


def write_grey(path: Path, image: NDArray[np.float32]) -> None:
    """Write an (H, W) float32 image without loss; inverse: `read_channels`.

    Raises:
        RenderError: It could not be written.
    """
    write_channels(path, {GREY: image})


def write_channels(path: Path, channels: Mapping[str, NDArray[Any]]) -> None:
    """Write (H, W) float32 channels by name without loss; inverse: `read_channels`.

    Raises:
        RenderError: They could not be written.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {name: np.ascontiguousarray(c, np.float32) for name, c in channels.items()}
    try:
        with OpenEXR.File(header, planes) as file:
            file.write(str(path))
    except (OSError, RuntimeError) as error:
        raise RenderError(f"{path}: could not be written: {error}") from error


def read_channels(path: Path) -> dict[str, NDArray[Any]]:
    """Return the (H, W) channels of all parts of an image, by name.

    Raises:
        InvalidInputError: It cannot be read.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: c for part in file.parts for name, c in part.channels.items()}
            return {name: np.asarray(channel.pixels) for name, channel in channels.items()}
    except (OSError, RuntimeError) as error:
        raise InvalidInputError("image", str(path), f"a readable EXR image ({error})") from error
