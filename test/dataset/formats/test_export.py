"""What all exports have in common: description, settings, errors; formats of other packages."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import mlcroissant
import numpy as np
import pytest
from commands import oaisys_here
from repository import REPOSITORY
from synthetic_datasets import LEGEND, dataset_info, drawn_arrays, frame_record

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.geometry import pose_from_matrix
from oaisys_dataset import Dataset
from oaisys_dataset.cli.export import export
from oaisys_dataset.formats.base import ExportOptions, format_named, format_names
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.places import open_place
from oaisys_dataset.shards import HEAD, writing_shard

EXAMPLE = REPOSITORY / "examples/extensions/dataset_format"


@pytest.fixture(scope="module")
def exported(rendered: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("export") / "out"
    export_dataset(rendered, "coco", target, ExportOptions(license="CC-BY-4.0", price_per_hour=7.2))
    return target


@pytest.mark.parametrize("name", format_names())
def test_every_format_states_its_conventions(name: str) -> None:
    found = format_named(name)
    assert found.name == name
    assert found.conventions.layout
    assert (type(found).__doc__ or "").strip()


def test_readme_states_layout_conventions_licence_and_counts(exported: Path) -> None:
    text = (exported / "README.md").read_text()
    for part in (
        "annotations/instances_SPLIT.json",
        "train: 2 worlds, 4 frames",
        "x right, y down, z forward",
        "`+inf`",
        "the centre of the first pixel is (0, 0)",
        "CC-BY-4.0",
        "| frames | 6 |",
    ):
        assert part in text


def test_mlcroissant_accepts_the_metadata_and_reads_every_frame(
    rendered: Dataset, exported: Path
) -> None:
    described = mlcroissant.Dataset(exported / "croissant.json")
    assert not described.metadata.issues.errors
    assert described.metadata.license == ["CC-BY-4.0"]
    rows = list(described.records("frames"))
    for row, record in zip(rows, rendered.records, strict=True):
        assert row["frames/frame_id"].decode() == record.frame_id
        assert row["frames/world"] == record.world
        assert row["frames/fx_px"] == record.intrinsics["fx_px"]
        pose = pose_from_matrix(record.T_map_camera)
        position = [row[f"frames/{axis}_m"] for axis in "xyz"]
        assert np.allclose(position, pose.position_m, rtol=0, atol=1e-9)


def test_the_table_of_frames_has_the_sun(rendered: Dataset, exported: Path) -> None:
    with (exported / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    suns = [float(row["sun_elevation_deg"]) for row in rows]
    assert suns == [record.sun_elevation_deg for record in rendered.records]


def test_the_data_card_shows_pictures_classes_histograms_and_cost(exported: Path) -> None:
    page = (exported / "data_card.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 1
    assert page.count("<svg") == 2
    # Six frames of 0.5 s at 7.2 an hour.
    for part in ("CC-BY-4.0", "rock", "sand", "6 from 3 worlds", "0.006 at 7.2 an hour"):
        assert part in page


def test_an_export_that_fails_leaves_nothing(
    rendered: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(RenderError, match="No space left"):
        export_dataset(rendered, "coco", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_wrong_names_and_folders_are_refused(rendered: Dataset, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="did you mean coco"):
        export_dataset(rendered, "cocoa", tmp_path / "out")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").write_text("kept")
    with pytest.raises(InvalidInputError, match="does not exist or is empty"):
        export_dataset(rendered, "coco", tmp_path / "mine")
    assert (tmp_path / "mine/file").read_text() == "kept"


def oaisys(*command: str, packages: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command; entry points in ``packages`` are known to it."""
    found = [str(EXAMPLE), str(packages), os.environ.get("PYTHONPATH", "")]
    path = {"PYTHONPATH": os.pathsep.join(found)} if packages else {}
    return subprocess.run(
        [sys.executable, "-m", "oaisys_core", *command],
        env={**os.environ, **path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_the_command_exports_in_a_format_of_another_package(
    rendered: Dataset, tmp_path: Path
) -> None:
    info = tmp_path / "packages/third_party-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third_party\nVersion: 1.0\n")
    points = "[oaisys.dataset_formats]\nnpz = npz_format:NpzFormat\n"
    (info / "entry_points.txt").write_text(points)
    result = oaisys(
        *("dataset", "export", rendered.place.url, "--format", "npz", "--split", "val"),
        *("--out", str(tmp_path / "out")),
        packages=info.parent,
    )
    assert result.returncode == 0, result.stderr
    assert "npz: 2 frames" in result.stdout
    for sample in rendered.split("val"):
        frame = np.load(tmp_path / f"out/val/{sample.record.frame_id}.npz")
        assert np.array_equal(frame["depth"], sample.arrays["depth"])
        assert np.array_equal(frame["T_map_camera"], sample.T_map_camera)
    assert json.loads((tmp_path / "out/croissant.json").read_text())["name"].endswith("npz")


def test_the_command_lists_formats_without_a_data_set() -> None:
    result = oaisys_here("dataset", "export", "--list")
    assert result.returncode == 0, result.stderr
    assert "kitti: Colour, depth, lidar and poses of each camera" in result.stdout
    assert "    --set compression=...: level of gzip" in result.stdout


def test_the_command_names_what_is_wrong(rendered: Dataset, tmp_path: Path) -> None:
    where, out = rendered.place.url, ("--out", str(tmp_path / "out"))
    result = oaisys_here("dataset", "export", where, "--format", "cocoa", *out)
    assert result.returncode == 2
    assert "did you mean coco" in result.stderr
    assert "Traceback" not in result.stderr
    with pytest.raises(InvalidInputError, match="--format with one of"):
        export(where)
    with pytest.raises(InvalidInputError, match="NAME=VALUE"):
        export(where, ["coco"], str(tmp_path / "out"), settings=["depth"])
    with pytest.raises(InvalidInputError, match="one --format"):
        export(where, ["coco", "hdf5"], str(tmp_path / "out"))
    with pytest.raises(InvalidInputError, match="one of train, val"):
        export(where, ["coco"], str(tmp_path / "out"), split="test")
    twice = ["depth_per_m=1000", "depth_per_m=2000"]
    with pytest.raises(InvalidInputError, match="each name once; depth_per_m is 1000"):
        export(where, ["kitti"], str(tmp_path / "out"), settings=twice)
    with pytest.raises(InvalidInputError, match="each format once"):
        export(where, ["coco", "coco"])
    assert not list(tmp_path.iterdir())


def test_the_list_of_formats_goes_alone(rendered: Dataset, tmp_path: Path) -> None:
    where = rendered.place.url
    for given in ((where,), ("--format", "coco"), ("--out", "x"), ("--license", "CC0")):
        result = oaisys_here("dataset", "export", *given, "--list")
        assert (result.returncode, result.stdout) == (2, "")
        assert "--list: received" in result.stderr
    result = oaisys_here("dataset", "export", "--format", "coco")
    assert result.returncode == 2
    assert "DIR: received None" in result.stderr


def test_an_export_in_which_every_frame_is_left_out_is_exit_1(tmp_path: Path) -> None:
    place = open_place(tmp_path / "set")
    place.write(HEAD, dataset_info(1, 3).to_json().encode())
    parts = (("rgb",), ("semantic_0", "instance"), ("rgb", "instance"))
    with writing_shard(place, 0) as shard:
        for view, modalities in enumerate(parts):
            pixels = drawn_arrays(np.random.default_rng(view))
            shard.add(frame_record(0, view, "train"), {name: pixels[name] for name in modalities})
        shard.finish(LEGEND)
    result = oaisys_here(
        "dataset", "export", place.url, "--format", "coco", "--out", f"{tmp_path}/out"
    )
    assert result.returncode == 1, result.stdout
    assert "coco: nothing to write: 3 frames without rgb, semantic_0, instance" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["set"]
    # Formats that need less write them all.
    more = ("--format", "webdataset", "--out", f"{tmp_path}/tar")
    result = oaisys_here("dataset", "export", place.url, *more)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("text", ["inf", "1e400", "nan", "-1", "word"])
def test_settings_are_finite_numbers(text: str) -> None:
    options = ExportOptions(settings={"depth_scale": text})
    with pytest.raises(InvalidInputError, match=r"settings\.depth_scale.*a finite number of at"):
        options.number("depth_scale", 1.0)


@pytest.mark.parametrize("text", ["inf", "1.5", "0"])
def test_counts_are_whole_numbers(text: str) -> None:
    options = ExportOptions(settings={"points": text})
    with pytest.raises(InvalidInputError, match=r"settings\.points"):
        options.count("points", 3, least=1)
    assert ExportOptions(settings={"points": "1e3"}).count("points", 3) == 1000
    assert ExportOptions().count("points", 3) == 3
