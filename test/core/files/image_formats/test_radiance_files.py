"""Radiance files: pixels as they are, and in both kinds of runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.environment.hdri import read_radiance

H, W = 16, 32
RNG = np.random.default_rng(5)


def rgbe(runs: bool = True) -> np.ndarray:
    """(H, W, 4) pixels; long runs of one."""
    pixels = RNG.integers(2, 256, (H, W, 4), np.uint8)
    pixels[..., 3] = RNG.integers(120, 140, (H, W))
    pixels[0, :3, 3] = 0
    if runs:
        pixels[:, 4:20] = pixels[:, 4:5]
        pixels[9] = pixels[9, :1]
    return pixels


def radiance(pixels: np.ndarray) -> np.ndarray:
    """What Radiance's color.c computes, without the half that it adds to each mantissa."""
    factor = np.where(pixels[..., 3] > 0, 2.0 ** (pixels[..., 3].astype(int) - 136), 0)
    return pixels[..., :3] * factor[..., None]


def old_runs(pixels: np.ndarray, most: int = 1000) -> bytes:
    """Each row with (1, 1, 1, n) where the pixel before comes n times more."""
    found = b""
    for row in pixels:
        at = 0
        while at < len(row):
            more = 0
            while (
                at + more + 1 < len(row) and more < most and (row[at + more + 1] == row[at]).all()
            ):
                more += 1
            found += row[at].tobytes() + (bytes([1, 1, 1, more]) if more else b"")
            at += more + 1
    return found


def saved(folder: Path, body: bytes, size: str = f"-Y {H} +X {W}", head: str = "") -> Path:
    text = f"#?RADIANCE\n{head}FORMAT=32-bit_rle_rgbe\n\n{size}\n"
    (folder / "sky.hdr").write_bytes(text.encode() + body)
    return folder / "sky.hdr"


@pytest.mark.parametrize("most", [1000, 3])
def test_runs_of_the_first_kind_are_read(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], most: int
) -> None:
    """They were called damaged."""
    pixels = rgbe()
    body = old_runs(pixels, most)
    assert np.array_equal(read_radiance(saved(tmp_path, body)), radiance(pixels))
    scaled = read_radiance(saved(tmp_path, body, head="EXPOSURE=4\n"))
    assert np.array_equal(scaled, radiance(pixels) / 4)
    assert capfd.readouterr().err == ""


def test_successive_runs_count_further_bits(tmp_path: Path) -> None:
    wide = np.broadcast_to(np.array([9, 8, 7, 130], np.uint8), (1, 700, 4))
    row = wide[0, 0].tobytes() + bytes([1, 1, 1, 187]) + bytes([1, 1, 1, 2])  # 1 + 187 + 2 * 256
    image = saved(tmp_path, row * 350, "-Y 350 +X 700")
    expected = np.broadcast_to(radiance(wide), (350, 700, 3))
    assert np.array_equal(read_radiance(image), expected)


def test_plain_pixels_are_read_whatever_they_begin_with(tmp_path: Path) -> None:
    pixels = rgbe(runs=False)
    assert np.array_equal(read_radiance(saved(tmp_path, pixels.tobytes())), radiance(pixels))
    pixels[0, 0] = (2, 2, 200, 128)  # which is no beginning of a row in runs
    assert np.array_equal(read_radiance(saved(tmp_path, pixels.tobytes())), radiance(pixels))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (rgbe(runs=False).tobytes()[:-4], f"{H * W - 1} pixels, not {H * W}"),
        (old_runs(rgbe())[:-4], f"pixels, not {H * W}"),
        (bytes([1, 1, 1, 5]) + rgbe().tobytes(), "begins with a run"),
        (
            b"\5\6\7\x80" + bytes([1, 1, 1, 255]) * 9 + rgbe().tobytes(),
            f"beyond its {H * W} pixels",
        ),
        (b"\2\2\0\x20" + bytes(40), "damaged"),
        (b"", f"0 pixels, not {H * W}"),
    ],
)
def test_other_numbers_of_pixels_are_refused_in_one_sentence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], body: bytes, said: str
) -> None:
    with pytest.raises(InvalidInputError, match=rf"environment\.hdri.*sky\.hdr.*{said}"):
        read_radiance(saved(tmp_path, body))
    assert capfd.readouterr().err == ""
