"""The table of objects, against trimesh, OpenCV and closed forms of the same objects."""

from __future__ import annotations

import io
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh
from numpy.typing import NDArray
from object_worlds import (
    BOX_M,
    BOX_POSITION_M,
    BOX_QUAT,
    SPHERE_POSITION_M,
    SPHERE_RADIUS_M,
    WEDGE_POSITION_M,
    WEDGE_QUAT,
    WEDGE_SCALE,
    object_config,
    pose_matrix,
    true_meshes,
)
from scipy.spatial import ConvexHull
from small_datasets import render_dataset

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.check import check_dataset
from oaisys_dataset.manifest import FrameRecord, WorldLegend
from oaisys_dataset.objects import COLUMNS, SCHEMA, ObjectRow, decode_objects, encode_objects
from oaisys_dataset.shards import objects_name

VIEWS = 6
EDGE_SHARE = 0.03
"""Of a silhouette's pixels: rays along an edge hit one of two meshes and miss the other."""

POSES = {
    "ball": pose_matrix(SPHERE_POSITION_M, (0, 0, 0, 1)),
    "crate": pose_matrix(BOX_POSITION_M, BOX_QUAT),
    "wedge": pose_matrix(WEDGE_POSITION_M, WEDGE_QUAT),
}


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("objects")
    lens = {"k1": -0.25, "k2": 0.06, "p1": 0.002, "p2": -0.001}
    size: dict[str, Any] = {"width_px": 64, "height_px": 48, "fx_px": 52.0, "fy_px": 50.0}
    size["modalities"] = ["rgb", "depth", "semantic_0", "instance"]
    fisheye = {**size, "name": "fisheye", "fisheye": {"k1": 0.01}, "fx_px": 25.0, "fy_px": 25.0}
    cameras = [{**size, "name": "camera"}, {**size, "name": "lens", "distortion": lens}, fisheye]
    config = object_config(folder, {"cameras": cameras})
    render_dataset(folder / "set", {0: "train"}, VIEWS, config)
    return open_dataset(folder / "set")


def rows(dataset: Dataset, sensor: str) -> list[tuple[FrameRecord, ObjectRow]]:
    records = [record for record in dataset.records if record.sensor == sensor]
    return [(record, row) for record in records for row in dataset.objects(record)]


def projected(record: FrameRecord, label: str) -> NDArray[np.float64]:
    """Return the (V, 2) pixels of an object's vertices, by OpenCV."""
    T_camera_map = np.linalg.inv(record.pose)
    turn, _ = cv2.Rodrigues(T_camera_map[:3, :3])
    lens = np.array(record.camera.distortion or (0.0,) * 5)
    points = true_meshes()[label].vertices
    pixels, _ = cv2.projectPoints(points, turn, T_camera_map[:3, 3], record.camera.K, lens)
    return np.asarray(pixels[:, 0], np.float64)


def silhouette(record: FrameRecord, label: str) -> NDArray[np.int64]:
    """Return (M, 2) pixels of a convex object's silhouette on a canvas of 3 x 3 images.

    They are in the convex hull of its projected vertices.
    """
    width, height = record.camera.width_px, record.camera.height_px
    u, v = np.meshgrid(np.arange(-width, 2 * width), np.arange(-height, 2 * height))
    pixels = np.stack((u.ravel(), v.ravel()), axis=-1)
    hull = ConvexHull(projected(record, label)).equations
    return np.asarray(pixels[(pixels @ hull[:, :2].T + hull[:, 2] <= 0).all(axis=1)])


def test_every_frame_has_a_row_for_each_object_that_shows(objects: Dataset) -> None:
    for sample in objects:
        ids = set(np.unique(sample.arrays["instance"]).tolist()) - {0}
        assert {row.instance_id for row in objects.objects(sample.record)} == ids
        for row in objects.objects(sample.record):
            mask = sample.arrays["instance"] == row.instance_id
            v, u = np.nonzero(mask)
            box = (u.min(), v.min(), u.max() - u.min() + 1, v.max() - v.min() + 1)
            assert row.visible_px == mask.sum()
            assert row.box_visible_px == box
            legend = objects.legend(0).instances[row.instance_id]
            assert (row.name, row.label, row.semantic_id) == (
                legend.name,
                legend.label,
                legend.semantic_id,
            )
            assert (sample.arrays["semantic_0"][mask] == row.semantic_id).all()


def test_poses_sizes_corners_and_distances_are_those_of_the_scene(objects: Dataset) -> None:
    meshes, seen = true_meshes(), set()
    sizes = {"ball": [2 * SPHERE_RADIUS_M] * 3, "crate": BOX_M, "wedge": (1.5, 1.05, 1.35)}
    for record, row in rows(objects, "camera"):
        seen.add(row.label)
        T = POSES[row.label]
        np.testing.assert_allclose(row.T_map_object, T, atol=1e-6)
        np.testing.assert_allclose(record.pose @ row.T_camera_object, T, atol=1e-6)
        np.testing.assert_allclose(row.size_m, sizes[row.label], atol=1e-6)
        assert row.scale == pytest.approx(WEDGE_SCALE if row.label == "wedge" else 1.0)
        local = trimesh.transform_points(meshes[row.label].vertices, np.linalg.inv(T))
        low, high = local.min(axis=0), local.max(axis=0)
        np.testing.assert_allclose(row.box_center_object_m, (low + high) / 2, atol=2e-3)
        corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
        corners = trimesh.transform_points(low + np.array(corners) * (high - low), T)
        np.testing.assert_allclose(row.corners_map_m, corners, atol=2e-3)
        in_camera = trimesh.transform_points(corners, np.linalg.inv(record.pose))
        np.testing.assert_allclose(row.corners_camera_m, in_camera, atol=2e-3)
        assert row.distance_m == pytest.approx(np.linalg.norm(in_camera.mean(axis=0)), abs=2e-3)
        points = meshes[row.label].vertices
        farthest = max(np.linalg.norm(points - point, axis=1).max() for point in points[:50])
        assert row.diameter_m == pytest.approx(farthest, abs=2e-3)
    assert seen == set(POSES)


def test_silhouettes_shares_and_amodal_boxes_are_those_of_convex_hulls(objects: Dataset) -> None:
    hidden = truncated = 0
    for record, row in rows(objects, "camera"):
        pixels = silhouette(record, row.label)
        size = record.camera.width_px, record.camera.height_px
        inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
        slack = 4 + EDGE_SHARE * len(pixels)
        assert row.silhouette_px == pytest.approx(len(pixels), abs=slack)
        assert row.silhouette_in_image_px == pytest.approx(inside.sum(), abs=slack)
        assert row.visible_share == row.visible_px / row.silhouette_px
        assert row.occlusion == 1 - row.visible_px / row.silhouette_in_image_px
        assert row.truncation == 1 - row.silhouette_in_image_px / row.silhouette_px
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        left, top, width, height = row.box_amodal_px
        np.testing.assert_allclose([left, top], low, atol=1)
        np.testing.assert_allclose([left + width - 1, top + height - 1], high, atol=1)
        hidden += row.occlusion > 0.1
        truncated += row.truncation > 0.1
    assert hidden
    assert truncated


def test_amodal_boxes_enclose_what_opencv_projects_through_a_lens(objects: Dataset) -> None:
    judged = 0
    for record, row in rows(objects, "lens"):
        pixels = projected(record, row.label)
        size = np.array((record.camera.width_px, record.camera.height_px))
        if not ((pixels > -0.5) & (pixels < size - 0.5)).all():
            continue
        judged += 1
        assert row.truncation == 0
        left, top, width, height = row.box_amodal_px
        np.testing.assert_allclose([left, top], np.ceil(pixels.min(axis=0)), atol=1)
        np.testing.assert_allclose([left + width, top + height], pixels.max(axis=0) + 1, atol=1.5)
    assert judged > 1


def test_a_fisheye_has_no_truncation_and_all_else(objects: Dataset) -> None:
    found = rows(objects, "fisheye")
    assert found
    for record, row in found:
        assert row.truncation is None
        left, top, width, height = row.box_amodal_px
        assert left >= 0
        assert left + width <= record.camera.width_px
        assert top >= 0
        assert top + height <= record.camera.height_px
        assert row.silhouette_px == row.silhouette_in_image_px >= row.visible_px


def test_any_reader_of_parquet_reads_the_documented_columns(objects: Dataset) -> None:
    assert objects.place.folder is not None
    table = pq.read_table(Path(objects.place.folder, "shards/world_000000.objects.parquet"))
    assert table.column_names == list(COLUMNS)
    first: dict[str, Any] = table.slice(0, 1).to_pylist()[0]
    assert first["frame_id"] == "000000_0000_camera"
    assert np.array(first["corners_map_m"]).shape == (8, 3)
    assert np.array(first["T_camera_object"]).shape == (4, 4)


def test_a_world_without_object_ids_has_no_table(tmp_path: Path) -> None:
    camera = {"width_px": 64, "height_px": 48, "modalities": ["depth"]}
    config = object_config(tmp_path, {"cameras": [camera]})
    render_dataset(tmp_path / "set", {0: "train"}, 1, config)
    dataset = open_dataset(tmp_path / "set")
    assert not dataset.has_objects(0)
    with pytest.raises(NotFoundError, match=r"objects\.parquet"):
        dataset.objects(dataset.records[0])


def changed_table(dataset: Dataset, name: str, change: Any, *, hashed: bool) -> None:
    """Change the values of a column of the first world, with a hash that is right or not."""
    table = dataset.objects_table(0)
    place = table.schema.get_field_index(name)
    values = change(table[name].to_pylist())
    changed = table.set_column(place, SCHEMA.field(name), pa.array(values, SCHEMA.field(name).type))
    if hashed:
        data = encode_objects(changed.to_batches(), dataset.legend(0))
        dataset.place.write(objects_name(0), data)
    else:
        assert dataset.place.folder is not None
        pq.write_table(changed, dataset.place.folder / objects_name(0))


@pytest.mark.parametrize(
    ("name", "change", "hashed"),
    [
        ("distance_m", lambda values: [value + 1e-9 for value in values], False),
        ("distance_m", lambda values: [value * 1.01 for value in values], True),
        ("occlusion", lambda values: [0.5] * len(values), True),
        ("size_m", lambda values: [[z, y, x] for x, y, z in values], True),
        ("box_amodal_px", lambda values: [[0, 0, 9, 9]] * len(values), True),
        ("visible_px", lambda values: [value + 1 for value in values], True),
        ("instance_id", lambda values: values[::-1], True),
    ],
)
def test_the_check_finds_rows_that_are_not_those_of_the_world(
    objects: Dataset, tmp_path: Path, name: str, change: Any, hashed: bool
) -> None:
    assert objects.place.folder is not None
    shutil.copytree(objects.place.folder, tmp_path / "set")
    changed_table(open_dataset(tmp_path / "set"), name, change, hashed=hashed)
    report = check_dataset(tmp_path / "set", worlds_rebuilt=int(hashed))
    assert "objects" in {finding.check for finding in report.findings}


def test_the_check_finds_a_missing_table_and_passes_what_was_rendered(
    objects: Dataset, tmp_path: Path
) -> None:
    assert objects.place.folder is not None
    found = check_dataset(objects.place.folder, worlds_rebuilt=1).findings
    assert "objects" not in {finding.check for finding in found}
    render_dataset(tmp_path / "set", {0: "train", 1: "train"}, 1, object_config(tmp_path))
    (tmp_path / "set" / objects_name(1)).unlink()
    (finding,) = check_dataset(tmp_path / "set", worlds_rebuilt=0).findings
    assert (finding.check, finding.subject) == ("objects", objects_name(1))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((each, None) for each in ("label", "scale", "instance_id", "visible_share", "frame_id")),
        *(("scale", each) for each in (0.0, -1.0, float("nan"), float("inf"), 1e300)),
        *(("label", each) for each in ("a\x1b[31mb", "a\nb", "a\0b", "x" * 2000, "x" * 5000)),
        *(("mesh_sha256", each) for each in ("../../../x", "", "g" * 64)),
        *(("visible_px", each) for each in (-1, 2**62)),
        *(("box_amodal_px", each) for each in ([0, 0, -1, 5], [-(2**62), 0, 5, 5])),
        *(("size_m", each) for each in ([None] * 3, [-1.0, 1.0, 1.0])),
        *(("T_camera_object", [[each] * 4] * 4) for each in (0.0, float("nan"), 1e300)),
    ],
)
def test_rows_that_no_world_can_have_are_refused_where_they_are_read(
    objects: Dataset, tmp_path: Path, name: str, value: Any
) -> None:
    assert objects.place.folder is not None
    shutil.copytree(objects.place.folder, tmp_path / "set")
    changed = open_dataset(tmp_path / "set")
    changed_table(changed, name, lambda values: [*values[:-1], value], hashed=False)
    with pytest.raises(InvalidInputError) as refused:
        open_dataset(tmp_path / "set").objects(changed.records[0])
    assert name in str(refused.value)
    assert len(str(refused.value)) < 500


def test_a_world_without_objects_has_an_empty_table() -> None:
    file = encode_objects([], WorldLegend(labels={}, instances={}))
    assert decode_objects(file, "objects.parquet").num_rows == 0


@pytest.mark.parametrize(
    ("rows", "text"), [(20, "x" * 1_000_000), pytest.param(1_500_000, "", marks=pytest.mark.long)]
)
def test_a_small_table_that_unfolds_to_gigabytes_is_refused(rows: int, text: str) -> None:
    """A text that repeats, and rows that repeat, take a few bytes in a file."""

    def repeat(kind: pa.DataType, count: int) -> pa.Array:
        if pa.types.is_fixed_size_list(kind):
            inner = repeat(kind.value_type, count * kind.list_size)
            return pa.FixedSizeListArray.from_arrays(inner, kind.list_size)
        value = pa.scalar(text if pa.types.is_string(kind) else 0, kind)
        return pa.repeat(value, count)

    part = pa.Table.from_arrays([repeat(field.type, 20) for field in SCHEMA], schema=SCHEMA)
    file = io.BytesIO()
    with pq.ParquetWriter(file, SCHEMA, compression="zstd") as writer:
        writer.write_table(pa.concat_tables([part] * (rows // 20)), row_group_size=rows)
    assert len(file.getvalue()) < 200_000
    before = pa.total_allocated_bytes()
    with pytest.raises(InvalidInputError, match="at most"):
        decode_objects(file.getvalue(), "table")
    assert pa.total_allocated_bytes() - before < 100 << 20
