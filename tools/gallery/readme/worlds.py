"""Six example worlds of different kinds in one picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from oaisys_core.config import adjust, load_config
from oaisys_core.simulation import Simulation
from oaisys_core.types import RGB, ModuleMetadata
from tools.gallery.look_book.views import Viewpoint

COLUMNS, GAP_PX = 3, 4
TILE_PX = (400, 268)
RENDERED_SIZE = "800x536"

WORLDS: dict[str, Viewpoint] = {
    "stage_alpine": Viewpoint("a high valley", (100.0, -180.0), 30.0, 120.0, 0.0),
    "stage_badlands": Viewpoint("badlands", (-45.0, -45.0), 6.0, 45.0, -6.0),
    "stage_slab_dunes": Viewpoint("dunes", (-25.0, -25.0), 5.0, 45.0, -8.0),
    "world_vegetation": Viewpoint("a meadow", (-8.0, -8.0), 0.9, 60.0, -3.0),
    "world_mars": Viewpoint("Mars", (-3.4, -8.0), 1.9, 80.0, -8.0),
    "world_moon": Viewpoint("the Moon", (-8.0, -8.8), 1.9, 47.0, -4.0),
}
"""Examples by name, and where each is looked at from."""


def write_worlds(path: Path, examples: Path, backend: str, render: str, quality: int) -> Path:
    """Render the worlds and write them as one WebP.

    Args:
        path: File to write.
        examples: Folder of the configurations.
        backend: Which renders.
        render: Quality of colour.
        quality: Of WebP, 0 to 100.
    """
    rows = -(-len(WORLDS) // COLUMNS)
    width_px, height_px = TILE_PX[0] + GAP_PX, TILE_PX[1] + GAP_PX
    strip = Image.new("RGB", (COLUMNS * width_px - GAP_PX, rows * height_px - GAP_PX), "white")
    for index, pixels in enumerate(_tiles(examples, backend, render)):
        row, column = divmod(index, COLUMNS)
        tile = Image.fromarray(pixels).resize(TILE_PX, Image.Resampling.LANCZOS)
        strip.paste(tile, (column * width_px, row * height_px))
    strip.save(path, "WEBP", quality=quality, method=6)
    return path


def _tiles(examples: Path, backend: str, render: str) -> Iterator[NDArray[np.uint8]]:
    """Yield each world's picture."""
    for name, view in WORLDS.items():
        config = load_config(examples / f"{name}.yaml")
        simulation = Simulation(adjust(config, backend=backend, quality=render, size=RENDERED_SIZE))
        try:
            simulation.step_batch()
            metadata = ModuleMetadata(sensor={"pose": view.pose(simulation)})
            sample = simulation.step_sample(metadata, modalities=[RGB])
            yield np.asarray(sample.frames[0].data[..., :3], np.uint8)
        finally:
            simulation.close()
