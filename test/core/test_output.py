"""Files written are read back by an independent reader."""

from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.output import SampleWriter, read_poses, write_image
from oaisys_core.types import Frame, PinholeIntrinsics, Pose, Provenance, Sample

CAMERA = PinholeIntrinsics(8, 6, 7.0, 7.0, 3.5, 2.5)


def frame(modality: str, data: np.ndarray) -> Frame:
    return Frame("camera", modality, data, CAMERA, np.eye(4))


@pytest.fixture
def sample() -> Sample:
    rng = np.random.default_rng(0)
    depth_m = rng.uniform(1, 60, (6, 8)).astype(np.float32)
    depth_m[0] = np.inf
    frames = (
        frame("rgb", rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)),
        frame("depth", depth_m),
        frame("semantic_0", rng.integers(0, 65536, (6, 8)).astype(np.uint16)),
        frame("instance", rng.integers(0, 65536, (6, 8)).astype(np.uint32)),
    )
    provenance = Provenance(1, 2, "ab", "analytic", "0", "standard", 4)
    pose = Pose((1.0, 2.5, 1 / 3), (0.0, 0.6, 0.0, 0.8))
    return Sample(1, 7, pose, frames, 0.1, provenance)


def test_files_are_named_as_the_original_names_them(tmp_path: Path, sample: Sample) -> None:
    names = [str(path.relative_to(tmp_path)) for path in SampleWriter(tmp_path).write(sample)]
    assert names == [
        "batch_0001/camera/0007camera_rgb_00.png",
        "batch_0001/camera/0007camera_pinhole_depth_00.exr",
        "batch_0001/camera/0007camera_semantic_label_00.png",
        "batch_0001/camera/0007camera_instance_label_00.png",
    ]


def test_images_come_back_bit_for_bit(tmp_path: Path, sample: Sample) -> None:
    rgb, depth, semantic, instance = SampleWriter(tmp_path).write(sample)
    expected = {frame.modality: frame.data for frame in sample.frames}

    def read(path: Path) -> np.ndarray:
        return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)

    assert np.array_equal(read(rgb)[..., ::-1], expected["rgb"])
    assert np.array_equal(OpenEXR.File(str(depth)).channels()["Y"].pixels, expected["depth"])
    assert np.array_equal(read(semantic), expected["semantic_0"])
    assert np.array_equal(read(instance), expected["instance"])


def test_poses_come_back_exactly(tmp_path: Path, sample: Sample) -> None:
    writer = SampleWriter(tmp_path)
    writer.write(sample)
    writer.write(sample)
    assert read_poses(tmp_path / "batch_0001" / "poses.csv") == [sample.rig_pose] * 2


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x_m\n1\n",
        "x_m,y_m,z_m,qx,qy,qz,qw\n1,2,3,0,0,0,no\n",
        "x_m,y_m,z_m,qx,qy,qz,qw\n1,2,3,0,0,0,0\n",
    ],
)
def test_a_file_without_poses_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInputError, match=r"poses\.csv"):
        read_poses(path)


def test_an_instance_id_too_large_for_its_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="65535"):
        write_image(tmp_path / "a.png", frame("instance", np.array([[70000]], np.uint32)))
