"""The README's pictures: few bytes, of worlds that there are, and a survey that moves."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image, ImageSequence
from repository import REPOSITORY

from oaisys_core.errors import InvalidInputError
from tools.gallery.gallery import EXAMPLES
from tools.gallery.readme.animation import SIZE_PX, write_animation
from tools.gallery.readme.worlds import COLUMNS, GAP_PX, TILE_PX, WORLDS

STRIP, ANIMATION = REPOSITORY / "docs" / "worlds.webp", REPOSITORY / "docs" / "survey.webp"
MOST_BYTES = 2_000_000


def test_the_pictures_are_small() -> None:
    assert STRIP.stat().st_size + ANIMATION.stat().st_size <= MOST_BYTES


def test_the_strip_has_a_tile_for_each_example_world() -> None:
    assert all((EXAMPLES / f"{name}.yaml").is_file() for name in WORLDS)
    with Image.open(STRIP) as strip:
        assert strip.width == COLUMNS * (TILE_PX[0] + GAP_PX) - GAP_PX
        assert strip.height == 2 * (TILE_PX[1] + GAP_PX) - GAP_PX


def test_the_animation_has_a_picture_for_each_view_and_the_verdict() -> None:
    with Image.open(ANIMATION) as animation:
        assert animation.size == SIZE_PX
        assert sum(1 for _ in ImageSequence.Iterator(animation)) == 30 + 1


def test_a_folder_without_a_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InvalidInputError, match="survey"):
        write_animation(tmp_path / "survey.webp", tmp_path, 80)
