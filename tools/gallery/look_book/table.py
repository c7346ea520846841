"""The look book's figures as a table, as JSON, and its pictures as a contact sheet."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from tools.gallery.look_book.figures import RANGES, Image
from tools.gallery.look_book.rendering import LookPicture, write_jpeg

TILE_PX = (240, 180)
CAPTION_PX = 16
COLUMNS = 8
MAX_SHEET_BYTES = 400_000
UNLIMITED = 1e6


def table(pictures: Sequence[LookPicture]) -> str:
    """Return a Markdown table of all figures; those out of the range have an asterisk."""
    headings = ["picture", *(each.name for each in RANGES.values())]
    limits = ["believed", *(_limits(key) for key in RANGES)]
    medians = ["median", *(RANGES[key].mark(_median(pictures, key)) for key in RANGES)]
    rows = [_row(picture) for picture in pictures]
    lines = [headings, ["---"] * len(headings), limits, medians, *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def write_json(path: Path, pictures: Sequence[LookPicture]) -> None:
    """Write all figures, with the ranges they are compared with."""
    ranges = {key: asdict(each) for key, each in RANGES.items()}
    content = {"ranges": ranges, "pictures": [asdict(picture) for picture in pictures]}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def write_sheet(path: Path, folder: Path, pictures: Sequence[LookPicture]) -> None:
    """Write a contact sheet of at most `MAX_SHEET_BYTES`; empty tiles are "not possible"."""
    width, height = TILE_PX
    rows = -(-len(pictures) // COLUMNS)
    sheet = np.full((rows * (height + CAPTION_PX), COLUMNS * width, 3), 255, np.uint8)
    for index, picture in enumerate(pictures):
        y, x = index // COLUMNS * (height + CAPTION_PX), index % COLUMNS * width
        sheet[y : y + height, x : x + width] = _tile(folder, picture)
        caption = f"{picture.world}: {picture.view}"
        _write(sheet, caption, (x + 3, y + height + 12), (40, 40, 40))
    for quality in range(88, 30, -6):
        write_jpeg(path, sheet, quality)
        if path.stat().st_size <= MAX_SHEET_BYTES:
            break


def _row(picture: LookPicture) -> list[str]:
    name = f"{picture.world}: {picture.view}"
    if picture.file is None:
        return [name, "not possible", *[""] * (len(RANGES) - 1)]
    return [name, *(RANGES[key].mark(picture.figures[key]) for key in RANGES)]


def _limits(key: str) -> str:
    digits, least, most = RANGES[key].digits, RANGES[key].least, RANGES[key].most
    if most >= UNLIMITED:
        return f"from {least:.{digits}f}"
    return f"{least:.{digits}f} to {most:.{digits}f}"


def _median(pictures: Sequence[LookPicture], key: str) -> float | None:
    values = [value for each in pictures if (value := each.figures.get(key)) is not None]
    return statistics.median(values) if values else None


def _tile(folder: Path, picture: LookPicture) -> Image:
    width, height = TILE_PX
    image = None if picture.file is None else cv2.imread(str(folder / picture.file))
    if image is None:
        empty = np.full((height, width, 3), 200, np.uint8)
        _write(empty, "not possible", (70, 95), (90, 90, 90))
        return empty
    return np.asarray(cv2.resize(image, TILE_PX, interpolation=cv2.INTER_AREA)[..., ::-1])


def _write(image: Image, text: str, at_px: tuple[int, int], color: tuple[int, int, int]) -> None:
    cv2.putText(image, text, at_px, cv2.FONT_HERSHEY_SIMPLEX, 0.36, color, 1, cv2.LINE_AA)
