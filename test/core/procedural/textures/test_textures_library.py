"""Every built-in texture set: it tiles, is as bright as such ground, has normals that fit."""

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from types import FrameType

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import oaisys_core
from oaisys_core.procedural.textures import TEXTURES, stands_out
from oaisys_core.procedural.textures.code_version import CODE, PACKAGE, code_files
from oaisys_core.procedural.textures.library import RECIPES, make_texture_set
from oaisys_core.scene import PbrMaps

SIZE = 192
NAMES = sorted(TEXTURES)
REQUIRED = {
    *("sand", "gravel", "regolith", "basalt", "clay_cracks", "grass", "moss", "snow", "mud"),
    *("rippled_sand", "bedrock", "ice"),
}


@pytest.fixture(scope="module")
def made() -> dict[str, PbrMaps]:
    return {name: make_texture_set(name, SIZE, 3) for name in NAMES}


def luminance(maps: PbrMaps) -> NDArray[np.float64]:
    """(N, N) linear luminance by the definition of sRGB, not by our code."""
    value = maps.color_srgb / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ np.array([0.2126, 0.7152, 0.0722]))


def power(image: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spectral power and the frequency, in waves per tile, of each coefficient."""
    axis = np.fft.fftfreq(len(image), 1 / len(image))
    spectrum = np.abs(np.fft.fft2(image - image.mean())) ** 2
    return np.asarray(spectrum), np.asarray(np.hypot(axis[:, None], axis[None, :]))


def test_the_sets_that_were_asked_for_are_there() -> None:
    assert REQUIRED <= TEXTURES


@pytest.mark.parametrize("name", NAMES)
def test_the_seam_is_like_any_other_row(made: dict[str, PbrMaps], name: str) -> None:
    maps = made[name]
    for image in (luminance(maps), maps.height, maps.normal_gl[..., 0], maps.roughness):
        for axis in (0, 1):
            field = np.asarray(image, float)
            steps = np.abs(field - np.roll(field, 1, axis)).mean(axis=1 - axis)
            seam, inside = steps[0], steps[1:]
            assert abs(seam - inside.mean()) < 5 * inside.std()


@pytest.mark.parametrize("name", NAMES)
def test_normals_are_those_of_the_height_map(made: dict[str, PbrMaps], name: str) -> None:
    maps = made[name]
    normal = (maps.normal_gl.astype(float) - 128) / 127
    # Sobel's differences by OpenCV look along rows and columns as ours do, but are another filter:
    # they are compared on a smoothed surface, where both see the same slope.
    wrapped = np.pad(maps.height, 8, mode="wrap")
    slope = [
        cv2.GaussianBlur(cv2.Sobel(wrapped, cv2.CV_64F, *order, ksize=1), (0, 0), 1.5)[8:-8, 8:-8]
        for order in ((1, 0), (0, 1))
    ]
    steep = np.maximum(normal[..., 2], 0.02)
    leaning = [
        cv2.GaussianBlur(np.pad(part, 8, mode="wrap"), (0, 0), 1.5)[8:-8, 8:-8]
        for part in (-normal[..., 0] / steep, normal[..., 1] / steep)
    ]
    expected, given = np.ravel(slope), np.ravel(leaning)
    assert np.corrcoef(expected, given)[0, 1] > 0.97
    # The factor between them says what a height of 1 stands for.
    relief_m = (given @ expected) / (expected @ expected) * 2 * maps.tile_m / SIZE
    assert 0.003 < relief_m < 0.3


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [3, 4])
def test_it_reflects_as_much_as_such_ground(made: dict[str, PbrMaps], name: str, seed: int) -> None:
    maps = made[name] if seed == 3 else make_texture_set(name, SIZE, seed)
    low, high = RECIPES[name].albedo
    assert low < luminance(maps).mean() < high
    # Nothing natural is brighter than fresh snow, and little of it is clipped.
    assert (maps.color_srgb == 255).all(axis=-1).mean() < 0.01


def test_the_brightest_and_the_darkest_ground() -> None:
    middle = {name: sum(RECIPES[name].albedo) / 2 for name in NAMES}
    order = sorted(middle, key=lambda name: middle[name])
    assert order[-3:] == ["salt_crust", "sastrugi", "snow"]
    assert {"lava", "gravel_dark", "mud"} == set(order[:3])


@pytest.mark.parametrize("name", NAMES)
def test_it_has_structure_of_many_sizes(made: dict[str, PbrMaps], name: str) -> None:
    for image in (luminance(made[name]), np.asarray(made[name].height, float)):
        spectrum, frequency = power(image)
        coarse = spectrum[(frequency >= 2) & (frequency < 12)].mean()
        fine = spectrum[(frequency >= 48) & (frequency < 96)].mean()
        # White noise would have 1; a photograph of ground falls off, yet has fine detail.
        assert coarse > 2.5 * fine
        assert fine > 1e-9 * coarse
        # No single wave is all there is to see.
        assert spectrum.max() < 0.3 * spectrum.sum()


@pytest.mark.parametrize("name", NAMES)
def test_no_part_of_the_tile_stands_out(made: dict[str, PbrMaps], name: str) -> None:
    image = luminance(made[name])
    parts = image.reshape(4, SIZE // 4, 4, SIZE // 4).mean(axis=(1, 3)) / image.mean()
    assert np.abs(parts - 1).max() < 0.35


def test_textures_with_large_forms_are_laid_without_repetition(made: dict[str, PbrMaps]) -> None:
    """Forms of a twelfth of a tile or more, under a sun at 25°."""
    for name, maps in made.items():
        across, _, up = np.moveaxis((maps.normal_gl.astype(float) - 128) / 127, -1, 0)
        light = np.clip(across * np.cos(0.436) + up * np.sin(0.436), 0, None)
        seen = np.tile(luminance(maps) * light, (3, 3))
        large = cv2.GaussianBlur(seen, (0, 0), SIZE / 24)[SIZE : 2 * SIZE, SIZE : 2 * SIZE]
        contrast = large.std() / large.mean()
        # Bowls and plates are small, but on such plains there is nothing else to see.
        is_plain = name in {"regolith", "salt_crust", "clay_cracks"}
        assert stands_out(name) == (contrast > 0.062 or is_plain), (name, contrast)


def test_colours_are_not_more_vivid_than_nature(made: dict[str, PbrMaps]) -> None:
    for name, maps in made.items():
        mean = (maps.color_srgb.reshape(-1, 3) / 255.0).mean(axis=0)
        saturation = 1 - mean.min() / mean.max()
        assert saturation < 0.62, name


MAKING = """
import sys
from pathlib import Path
from oaisys_core.procedural.textures.library import texture_set
maps = texture_set("snow", 32, 0, Path(sys.argv[1]) if sys.argv[1:] else None)
sys.stdout.buffer.write(maps.normal_gl.tobytes() + maps.height.tobytes())
"""


def test_a_set_that_other_code_has_put_into_the_cache_is_made_again(tmp_path: Path) -> None:
    """A change of how normals are encoded left sets in use, and pictures that did not repeat."""
    folder, package = tmp_path / "cache", Path(oaisys_core.__file__).parent
    folder.mkdir()
    shutil.copytree(package, tmp_path / "code" / "oaisys_core")

    def made(*arguments: Path) -> bytes:
        words = [sys.executable, "-c", MAKING, *map(str, arguments)]
        environment = {**os.environ, "PYTHONPATH": str(tmp_path / "code")}
        return subprocess.run(words, env=environment, check=True, stdout=subprocess.PIPE).stdout

    before = made(folder)
    assert made(folder) == before
    assert len(list(folder.iterdir())) == 1
    with (tmp_path / "code/oaisys_core/procedural/textures/normal_maps.py").open("a") as file:
        file.write("\n_encoded = encode_normals\n")
        file.write("\ndef encode_normals(normals):\n    return 255 - _encoded(normals)\n")
    assert made() != before
    assert made(folder) == made()


def test_the_key_of_the_cache_has_all_code_that_makes_a_set() -> None:
    ran: set[Path] = set()

    def note(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call":
            ran.add(Path(frame.f_code.co_filename))

    before = sys.getprofile()
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        for name in NAMES:
            make_texture_set(name, 16, 0)
    finally:
        sys.setprofile(before)
        threading.setprofile(None)
    ours = {path for path in ran if path.is_relative_to(PACKAGE)}
    assert len(ours) > 10
    assert ours <= set(code_files())
    assert [name for name in CODE if not (PACKAGE / name).exists()] == []
