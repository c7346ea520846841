"""The site's small pictures: one for each name, and two that differ for each key."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from repository import REPOSITORY

from tools.gallery.names.keys import KEY_PAIRS, PAIRS, KeyPair
from tools.gallery.names.looks_page import PAGE, looks_text
from tools.gallery.names.worlds import SIZE_PX, all_pictures

FOLDER = REPOSITORY / "docs" / "pictures"
MOST_BYTES_EACH, MOST_BYTES = 40_000, 3_000_000
LEAST_DIFFERENCE = 2.0
"""Mean difference of two pictures, out of 255; noise of rendering and of WebP is below 1."""


def test_each_name_has_a_picture() -> None:
    wanted = {f"{each.group}/{each.name}.webp" for each in all_pictures()}
    there = {file.relative_to(FOLDER).as_posix() for file in FOLDER.rglob("*.webp")}
    there -= {f"{PAIRS}/{pair.name}.webp" for pair in KEY_PAIRS}
    assert there == wanted, "run `make site-pictures SITE_PICTURES_ARGS=--missing`"
    for name in wanted:
        with Image.open(FOLDER / name) as picture:
            assert picture.size == SIZE_PX
            assert np.asarray(picture).std() > LEAST_DIFFERENCE, name


def test_the_pictures_are_small() -> None:
    sizes = [file.stat().st_size for file in FOLDER.rglob("*.webp")]
    assert max(sizes) <= MOST_BYTES_EACH
    assert sum(sizes) <= MOST_BYTES


@pytest.mark.parametrize("pair", KEY_PAIRS, ids=lambda pair: str(pair.name))
def test_the_values_of_a_key_look_different(pair: KeyPair) -> None:
    with Image.open(FOLDER / PAIRS / f"{pair.name}.webp") as picture:
        pixels = np.asarray(picture.convert("RGB"), np.float64)
    left, right = pixels[:, : SIZE_PX[0]], pixels[:, -SIZE_PX[0] :]
    assert np.abs(left - right).mean() > LEAST_DIFFERENCE


def test_the_page_of_keys_is_that_of_the_code() -> None:
    assert PAGE.read_text(encoding="utf-8") == looks_text(), "run `make site-pictures`"
