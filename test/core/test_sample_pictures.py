"""What a person and a notebook see of a sample, and the files it is saved to."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import Frame, PinholeIntrinsics, Pose, Provenance, Sample
from oaisys_core.types.sample_pictures import NOTHING_RGB, frame_picture, sheet

K = PinholeIntrinsics(4, 3, 5.0, 5.0, 1.5, 1.0)


def frame(modality: str, data: np.ndarray) -> Frame:
    return Frame("<cam>", modality, data, K, np.eye(4))


@pytest.fixture
def sample() -> Sample:
    depth_m = np.full((3, 4), 2.0, np.float32)
    depth_m[0], depth_m[2] = np.inf, 8.0
    frames = (
        frame("rgb", np.arange(36, dtype=np.uint8).reshape(3, 4, 3)),
        frame("depth", depth_m),
        frame("instance", np.arange(12, dtype=np.uint32).reshape(3, 4)),
    )
    provenance = Provenance(0, 0, "", "analytic", "", "draft", 0)
    return Sample(2, 5, Pose((0, 0, 0), (0, 0, 0, 1)), frames, 0.1, provenance)


def test_colours_stay_and_depth_goes_from_bright_to_dark(sample: Sample) -> None:
    colors, depth = sample.frames[0].data, frame_picture(sample.frames[1].data)
    np.testing.assert_array_equal(frame_picture(colors), colors)
    assert depth[0, 0].tolist() == list(NOTHING_RGB)
    assert depth[1, 0].tolist() == [255, 255, 255]
    assert depth[2, 0].tolist() == [0, 0, 0]


def test_distances_are_shown_by_their_logarithm() -> None:
    picture = frame_picture(np.array([[1.0, 10.0, 100.0]], np.float32))
    assert picture[0, :, 0].tolist() == [255, 128, 0]


def test_each_id_has_a_colour_and_zero_is_black(sample: Sample) -> None:
    picture = frame_picture(sample.frames[2].data).reshape(-1, 3)
    assert picture[0].tolist() == [0, 0, 0]
    assert len(np.unique(picture, axis=0)) == 12


def test_a_frame_without_any_finite_value_is_one_colour() -> None:
    picture = frame_picture(np.full((2, 2), np.inf, np.float32))
    assert np.unique(picture.reshape(-1, 3), axis=0).tolist() == [list(NOTHING_RGB)]


def test_a_notebook_gets_every_picture_and_no_name_becomes_markup(sample: Sample) -> None:
    html = sample._repr_html_()
    assert "batch 2 sample 5" in html
    assert "<cam>" not in html
    assert "depth: float32 3×4, 2 to 8" in html
    pictures = re.findall(r"base64,([^']+)'", html)
    shown = [Image.open(io.BytesIO(base64.b64decode(each))) for each in pictures]
    assert [each.size for each in shown] == [(4, 3)] * 3
    np.testing.assert_array_equal(np.asarray(shown[0]), sample.frames[0].data)


def test_arrays_are_saved_as_they_are(sample: Sample, tmp_path: Path) -> None:
    saved = np.load(sample.save(tmp_path / "new" / "sample.npz"))
    for each in sample.frames:
        stored = saved[f"<cam>/{each.modality}"]
        assert stored.dtype == each.data.dtype
        np.testing.assert_array_equal(stored, each.data)
    np.testing.assert_array_equal(saved["<cam>/K"], np.array([[5, 0, 1.5], [0, 5, 1], [0, 0, 1]]))


def test_pictures_are_saved_side_by_side(sample: Sample, tmp_path: Path) -> None:
    saved = np.asarray(Image.open(sample.save(tmp_path / "sample.png")))
    np.testing.assert_array_equal(saved, sheet(sample.frames))
    np.testing.assert_array_equal(saved[:, :4], sample.frames[0].data)


def test_another_suffix_and_a_sample_without_images_are_refused(
    sample: Sample, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInputError, match=r"path: received .*sample\.gif.*\.npz"):
        sample.save(tmp_path / "sample.gif")
    with pytest.raises(ValueError, match="0 images, at least 1"):
        sheet([])
