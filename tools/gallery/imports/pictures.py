"""Renders the ten worlds and joins their pictures with captions: ``imports.webp``."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
import yaml
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

# Must come before anything that loads Open3D, see oaisys_core.raycast.triangles.
import oaisys_core.render.blender  # noqa: F401
from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, ModuleMetadata, Pose
from tools.gallery.imports.worlds import TILE_PX, ImportedWorld, Outlook, make_worlds

SHEET = "imports.webp"
COLUMNS, GAP_PX, CAPTION_PX, FONT_PX = 2, 8, 30, 17
MOST_BYTES = 300_000
NEAR_M, FAR_M = 1.0, 12.0
"""Depths that a picture of depth shows."""

Pixels = NDArray[np.uint8]


def main(
    out: Annotated[Path, typer.Option(help="Folder for the files and the pictures.")],
    only: Annotated[str, typer.Option(help="Render only names that contain this.")] = "",
    quality: Annotated[str, typer.Option(help="Quality of colour.")] = "high",
    backend: Annotated[str, typer.Option(help="blender or analytic.")] = "blender",
) -> None:
    """Make ten files as people bring them, render what they become, and write imports.webp."""
    logging.basicConfig(level=logging.WARNING)
    with own_stdout():
        render_imports(out, only, quality, backend)


def render_imports(out: Path, only: str, quality: str, backend: str) -> Path:
    """Write the files, and a configuration and a picture of each world with ``only`` in its name.

    Returns:
        The sheet with their pictures.
    """
    files = out / "files"
    tiles = []
    for world in make_worlds(files):
        if only not in world.name:
            continue
        text = yaml.safe_dump(world.sections, sort_keys=False, default_flow_style=None)
        (files / f"{world.name}.yaml").write_text(f"# {world.caption}\n{text}", encoding="utf-8")
        tile = render_tile(world, files, quality, backend)
        Image.fromarray(tile).save(out / f"{world.name}.png")
        tiles.append((world.caption, tile))
        typer.echo(f"{world.name}: {world.caption}")
    return write_sheet(out / SHEET, tiles)


def render_tile(world: ImportedWorld, files: Path, quality: str, backend: str) -> Pixels:
    """Return the (H, W, 3) picture of a world."""
    more = {"backend": backend, "render": {"quality": quality}}
    simulation = Simulation(config_from_mapping(world.sections | more, files))
    try:
        simulation.step_batch()
        images: list[Pixels] = []
        for view in world.views or (None,) * world.samples:
            sensor = None if view is None else {"pose": _pose(view, simulation)}
            sample = simulation.step_sample(ModuleMetadata(sensor=sensor))
            images += [
                _picture(frame)
                for modality in world.modalities
                for frame in sample.frames
                if frame.modality == modality
            ]
    finally:
        simulation.close()
    order = world.order or tuple(range(len(images)))
    return _join([images[index] for index in order], world.columns)


def _pose(view: Outlook, simulation: Simulation) -> Pose:
    """Return the pose of the rig that looks from one place above the surface at another."""
    places = [(*view.eye_m, 0.0), (*view.target_m, 0.0)]
    ground_m, target_m = simulation.query_height(places).ground_height_m
    eye = (*view.eye_m, float(ground_m) + view.height_m)
    return pose_looking_at(eye, (*view.target_m, float(target_m) + view.rise_m))


def _picture(frame: Frame) -> Pixels:
    """Return colours of a frame; of depth, near is red and far is blue."""
    if frame.modality != "depth":
        return np.asarray(frame.data[..., :3], np.uint8)
    import cv2

    share = np.clip((frame.data - NEAR_M) / (FAR_M - NEAR_M), 0, 1)
    levels = np.nan_to_num(255 * (1 - share), nan=0.0).astype(np.uint8)
    colors = cv2.applyColorMap(levels, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(np.isfinite(frame.data)[..., None], colors, 235).astype(np.uint8)


def _join(images: Sequence[Pixels], columns: int) -> Pixels:
    """Return images in rows, of the size of a tile, with thin lines between them."""
    width, height = TILE_PX
    tile = Image.new("RGB", TILE_PX, "white")
    rows = -(-len(images) // columns)
    for index, pixels in enumerate(images):
        left, right = (round(width * (index % columns + k) / columns) for k in (0, 1))
        top, bottom = (round(height * (index // columns + k) / rows) for k in (0, 1))
        line = 0 if len(images) == 1 else 1
        image = _fill(Image.fromarray(pixels), (right - left - line, bottom - top - line))
        tile.paste(image, (left, top))
    return np.asarray(tile, np.uint8)


def _fill(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Return an image that is cut and resized to a size, its middle kept."""
    share = max(size[0] / image.width, size[1] / image.height)
    wide, high = size[0] / share, size[1] / share
    left, top = (image.width - wide) / 2, (image.height - high) / 2
    return image.resize(size, Image.Resampling.LANCZOS, (left, top, left + wide, top + high))


def write_sheet(path: Path, tiles: Sequence[tuple[str, Pixels]]) -> Path:
    """Write tiles with their captions as one WebP of at most `MOST_BYTES`."""
    width, height = TILE_PX
    rows = -(-len(tiles) // COLUMNS)
    cell = (width + GAP_PX, height + CAPTION_PX + GAP_PX)
    sheet = Image.new("RGB", (COLUMNS * cell[0] - GAP_PX, rows * cell[1] - GAP_PX), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(FONT_PX)
    for index, (caption, tile) in enumerate(tiles):
        x, y = index % COLUMNS * cell[0], index // COLUMNS * cell[1]
        sheet.paste(Image.fromarray(tile), (x, y))
        draw.text((x + 2, y + height + 5), caption, (30, 30, 30), font)
    for quality in range(90, 20, -5):
        sheet.save(path, "WEBP", quality=quality, method=6)
        if path.stat().st_size <= MOST_BYTES:
            break
    return path
