"""Files written are read back by an independent reader."""

import io
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from oaisys_core.config import SimulationConfig, load_config
from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.output.images import decode_image, read_image, write_image
from oaisys_core.output.poses import read_poses
from oaisys_core.output.reader import read_intrinsics, read_labels, read_sample, read_samples
from oaisys_core.output.tiff import encode_floats
from oaisys_core.output.writer import SampleWriter
from oaisys_core.types import (
    Frame,
    GroupCount,
    PinholeIntrinsics,
    Pose,
    Provenance,
    Sample,
    modality_spec,
)

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
    provenance = Provenance(1, 2, "ab" * 32, "analytic", "0", "standard", 4)
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


def test_counts_of_groups_are_written_once_per_batch(tmp_path: Path) -> None:
    writer = SampleWriter(tmp_path)
    writer.write_counts(1, ())
    assert not (tmp_path / "batch_0001").exists()
    writer.write_counts(2, (GroupCount("grass", 9, 7),))
    written = json.loads((tmp_path / "batch_0002" / "counts.json").read_text(encoding="utf-8"))
    assert written == {"grass": {"asked": 9, "placed": 7}}


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


ALL = (
    "rgb", "depth", "range", "semantic_0", "semantic_9", "instance", "normal", "flow", "albedo"
)  # fmt: skip


def drawn(modality: str, rng: np.random.Generator) -> np.ndarray:
    spec = modality_spec(modality)
    shape = (6, 8) if spec.channels == 1 else (6, 8, spec.channels)
    if spec.dtype.kind == "f":
        data = rng.normal(size=shape).astype(np.float32)
        data[0, 0], data[1, 1] = np.inf, np.nan
        return data
    return rng.integers(0, np.iinfo(spec.dtype).max, shape, spec.dtype, endpoint=True)


def test_a_sample_of_all_modalities_comes_back_whole(tmp_path: Path, sample: Sample) -> None:
    rng = np.random.default_rng(1)
    camera = replace(CAMERA, distortion=(-0.2, 0.01, 1e-3, -1e-3, 0.0))
    T_map_camera = pose_to_matrix(Pose((1.0, -2.0, 0.1), (0.5, -0.5, 0.5, -0.5)))
    frames = tuple(
        Frame(sensor, modality, drawn(modality, rng), camera, T_map_camera)
        for sensor in ("left", "right")
        for modality in ALL
    )
    written = replace(sample, frames=frames)
    writer = SampleWriter(tmp_path)
    writer.write(written, {1: "gravel", 7: "Sand, wet"})
    writer.write(replace(sample, sample_id=9), {})
    batch = tmp_path / "batch_0001"
    found = read_sample(batch, 7)
    assert replace(found, frames=()) == replace(written, frames=())
    for got, expected in zip(found.frames, frames, strict=True):
        assert (got.sensor, got.modality) == (expected.sensor, expected.modality)
        assert got.intrinsics == camera
        assert np.array_equal(got.T_map_camera, T_map_camera)
        assert got.data.dtype == expected.data.dtype
        assert got.data.tobytes() == expected.data.tobytes()
    assert [sample.sample_id for sample in read_samples(batch)] == [7, 9]
    assert read_labels(batch) == {1: "gravel", 7: "Sand, wet"}
    assert read_intrinsics(batch, "left") == camera
    (pose,) = read_poses(batch / "meta_data/sensor_data/right.csv")
    assert np.allclose(pose_to_matrix(pose), T_map_camera, atol=1e-12)


def test_the_original_names_files_so(tmp_path: Path, sample: Sample) -> None:
    rng = np.random.default_rng(1)
    for modality, name in {
        "range": "0007camera_euclidean_depth_00.exr",
        "semantic_3": "0007camera_semantic_label_03.png",
        "instance": "0007camera_instance_label_00.tif",
        "normal": "0007camera_normal_00.exr",
    }.items():
        frames = (frame(modality, drawn(modality, rng)),)
        (path,) = SampleWriter(tmp_path).write(replace(sample, frames=frames))
        assert path.name == name


def test_large_instance_ids_are_read_by_others(tmp_path: Path) -> None:
    ids = np.array([[0, 1, 70000], [2**31 - 1, 65536, 3]], np.uint32)
    path = tmp_path / "ids.tif"
    write_image(path, frame("instance", ids))
    assert np.array_equal(np.asarray(Image.open(path)).astype(np.uint32), ids)
    assert np.array_equal(read_image(path, "instance"), ids)


@pytest.mark.parametrize("modality", ["depth", "flow", "normal"])
def test_floats_in_a_tiff_file_keep_all_their_bits(modality: str) -> None:
    channels = modality_spec(modality).channels
    rng = np.random.default_rng(2)
    bits = rng.integers(0, 2**32, (31, 17, channels), np.uint32)
    data = bits.view(np.float32)
    data[3:5, 2:8] = np.inf
    data[6, 2:4] = -0.0
    data = np.ascontiguousarray(data[..., 0] if channels == 1 else data)
    file = encode_floats(data)
    assert file == encode_floats(data)
    assert decode_image(file, modality, "a.tif").tobytes() == data.tobytes()
    if channels == 1:
        assert np.asarray(Image.open(io.BytesIO(file))).tobytes() == data.tobytes()
    with pytest.raises(InvalidInputError, match=r"a\.tif"):
        decode_image(file, "disparity" if channels > 1 else "normal", "a.tif")
    with pytest.raises(InvalidInputError, match=r"a\.tif"):
        decode_image(file[: len(file) // 2], modality, "a.tif")


def test_an_image_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match=r"\.tif"):
        write_image(tmp_path / "a.png", frame("instance", np.array([[70000]], np.uint32)))
    write_image(tmp_path / "a.exr", frame("normal", np.zeros((2, 2, 3), np.float32)))
    with pytest.raises(InvalidInputError, match=r"a\.exr"):
        read_image(tmp_path / "a.exr", "depth")
    with pytest.raises(InvalidInputError, match=r"b\.png"):
        read_image(tmp_path / "b.png", "rgb")


def test_a_folder_with_a_run_is_not_written_over(tmp_path: Path) -> None:
    SampleWriter(tmp_path).begin(SimulationConfig())
    with pytest.raises(InvalidInputError, match="--resume"):
        SampleWriter(tmp_path).begin(SimulationConfig())
    with pytest.raises(InvalidInputError, match="configuration"):
        SampleWriter(tmp_path).resume(SimulationConfig(seed=7))
    assert load_config(tmp_path / "config.yaml") == SimulationConfig()


def test_resuming_takes_away_what_was_begun(tmp_path: Path, sample: Sample) -> None:
    writer = SampleWriter(tmp_path)
    writer.begin(SimulationConfig())
    writer.write(sample)
    writer.write_state({"last_batch_id": 1, "batch": {"sample_id": 7}})
    writer.write(replace(sample, sample_id=8))
    writer.write(replace(sample, batch_id=2, sample_id=1))
    state = SampleWriter(tmp_path).resume(SimulationConfig())
    assert state == {"last_batch_id": 1, "batch": {"sample_id": 7}}
    for table in ("poses.csv", "meta_data/sensor_data/camera.csv"):
        assert len((tmp_path / "batch_0001" / table).read_text().splitlines()) == 2
        assert len((tmp_path / "batch_0002" / table).read_text().splitlines()) == 1


FULL_DISK = """
import resource, sys, signal
from pathlib import Path
import numpy as np
from oaisys_core.errors import RenderError
from oaisys_core.output.images import write_image
from oaisys_core.output.poses import append_pose
from oaisys_core.types import Frame, PinholeIntrinsics, Pose

out = Path(sys.argv[1])
rng = np.random.default_rng(0)
camera = PinholeIntrinsics(64, 64, 60.0, 60.0, 31.5, 31.5)
data = {"rgb": rng.integers(0, 256, (64, 64, 3)).astype(np.uint8),
        "depth": rng.normal(size=(64, 64)).astype(np.float32),
        "instance": rng.integers(0, 2**31, (64, 64)).astype(np.uint32)}
append_pose(out / "poses.csv", 1, Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (80, 80))
for modality, kind in (("rgb", "png"), ("depth", "exr"), ("instance", "tif")):
    try:
        frame = Frame("camera", modality, data[modality], camera, np.eye(4))
        write_image(out / f"{modality}.{kind}", frame)
    except RenderError as error:
        print(modality, error)
try:
    append_pose(out / "poses.csv", 2, Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
except RenderError as error:
    print("poses", error)
"""


def test_where_no_more_can_be_written_nothing_is_half_written(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
    )
    told = [line.split()[0] for line in result.stdout.splitlines()]
    assert told == ["rgb", "depth", "instance", "poses"], result.stdout + result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["poses.csv"]
    assert len(read_poses(tmp_path / "poses.csv")) == 1
