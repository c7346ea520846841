"""EXR images whose header is whole and whose pixels are damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.output.exr import read_channels
from oaisys_core.procedural.environment.hdri import read_radiance
from oaisys_core.procedural.terrain.elevation.reading import read_model
from oaisys_core.procedural.textures.map_pixels import read_color

READERS: dict[str, Callable[[Path], object]] = {
    "record": read_channels,
    "texture": read_color,
    "sky": read_radiance,
    "elevation": lambda path: read_model(DemConfig(file=path), "stage.dem"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("damage", ["line number", "cut"])
def test_damaged_pixels_are_refused(tmp_path: Path, reader: str, damage: str) -> None:
    """By the standard the table of offsets follows the header, and a line's number its offset."""
    file = tmp_path / "image.exr"
    pixels = np.random.default_rng(1).random((8, 16), np.float32)
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, dict.fromkeys("RGB", pixels)).write(str(file))
    READERS[reader](file)
    data = bytearray(file.read_bytes())
    size = len(data)
    line = 8 + 3 * 4 * 16  # number, size, values of three channels
    first, table = size - 8 * line, size - 8 * line - 8 * 8
    assert int.from_bytes(data[table : table + 8], "little") == first
    if damage == "line number":
        data[first] ^= 1
    file.write_bytes(data[: size - line // 2] if damage == "cut" else data)
    with pytest.raises(InvalidInputError, match=r"image\.exr"):
        READERS[reader](file)
