"""Renders the small pictures and writes them as WebP."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from itertools import groupby
from pathlib import Path

from PIL import Image

from oaisys_core.simulation import Simulation
from oaisys_core.types import RGB, ModuleMetadata
from tools.gallery.names.worlds import NamedPicture

WEBP_QUALITY = 72


def render_pictures(
    pictures: Iterable[NamedPicture], backend: str, quality: str
) -> Iterator[tuple[NamedPicture, Image.Image]]:
    """Yield pictures as they are rendered; those in a row that share a world have it made once."""
    for config, views in groupby(pictures, lambda each: each.full_config(backend, quality)):
        with closing(Simulation(config)) as simulation:
            simulation.step_batch()
            for picture in views:
                metadata = ModuleMetadata(sensor={"pose": picture.view.pose(simulation)})
                sample = simulation.step_sample(metadata, modalities=[RGB])
                yield picture, Image.fromarray(sample.frames[0].data[..., :3])


def write_picture(image: Image.Image, path: Path) -> None:
    """Write a picture; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, "WEBP", quality=WEBP_QUALITY, method=6)


def beside(left: Image.Image, right: Image.Image, gap_px: int = 4) -> Image.Image:
    """Return two pictures of one size side by side."""
    pair = Image.new("RGB", (2 * left.width + gap_px, left.height), "white")
    pair.paste(left, (0, 0))
    pair.paste(right, (left.width + gap_px, 0))
    return pair
