"""Renders the look book's pictures and measures them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from oaisys_core.config import SimulationConfig, adjust
from oaisys_core.errors import OaisysError
from oaisys_core.simulation import Simulation
from oaisys_core.types import DEPTH, INSTANCE, RGB, ModuleMetadata
from tools.gallery.look_book.figures import Image, picture_figures
from tools.gallery.look_book.views import LookWorld, Viewpoint

JPEG_QUALITY = 92


@dataclass(frozen=True)
class LookPicture:
    """A picture of the look book.

    Attributes:
        world: Name of the world.
        view: Viewpoint and light, as text.
        file: Name of the image, or None where the world cannot be made.
        error: Why it cannot.
        figures: See `picture_figures`.
    """

    world: str
    view: str
    file: str | None
    error: str
    figures: dict[str, float | None]


def render_world(
    world: LookWorld, out: Path, backend: str, quality: str, size: str
) -> Iterator[LookPicture]:
    """Yield the pictures of a world after their files are written.

    Args:
        world: Which is built once for all its pictures.
        out: Folder of the images.
        backend: Which renders.
        quality: Quality of colour.
        size: ``WIDTHxHEIGHT``.
    """
    try:
        config = adjust(world.config(), backend=backend, quality=quality, size=size)
        yield from _render(world, config, out)
    except OaisysError as error:
        for viewpoint, sun_deg in world.views:
            yield LookPicture(world.name, view_name(viewpoint, sun_deg), None, str(error), {})


def _render(world: LookWorld, config: SimulationConfig, out: Path) -> Iterator[LookPicture]:
    simulation = Simulation(config)
    try:
        simulation.step_batch()
        for viewpoint, sun_deg in world.views:
            environment = None if sun_deg is None else {"sun_elevation_deg": sun_deg}
            metadata = ModuleMetadata(
                sensor={"pose": viewpoint.pose(simulation)}, environment=environment
            )
            sample = simulation.step_sample(metadata, modalities=[RGB, DEPTH, INSTANCE])
            data = {frame.modality: frame.data for frame in sample.frames}
            name = view_name(viewpoint, sun_deg)
            file = f"look_book_{world.name}_{name}.jpg".replace(" ", "_")
            write_jpeg(out / file, data[RGB], JPEG_QUALITY)
            is_sky = ~np.isfinite(data[DEPTH])
            figures = picture_figures(data[RGB], is_sky, data[INSTANCE] > 0)
            yield LookPicture(world.name, name, file, "", figures)
    finally:
        simulation.close()


def view_name(viewpoint: Viewpoint, sun_deg: float | None) -> str:
    """Return the name of a picture among those of its world."""
    return viewpoint.name if sun_deg is None else f"{viewpoint.name}, sun {sun_deg:.0f} deg"


def write_jpeg(path: Path, image: Image, quality: int) -> None:
    """Write an RGB image."""
    if not cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality]):
        raise OSError(f"cannot write {path}")
