"""Exports from URLs to URLs: the files that a folder gets, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fsspec
import pytest
from rendered_datasets import write_rendered_dataset
from typer.testing import CliRunner

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.cli.dataset import dataset_app
from oaisys_dataset.cli.export import export
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.places import RemotePlace, open_place

COMMON = ("README.md", "croissant.json", "data_card.html", "frames.csv")


def files_below(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def objects_below(url: str) -> dict[str, bytes]:
    place = open_place(url)
    return {name: place.read(name) for name in _names(url)}


def _names(url: str) -> list[str]:
    files, root = fsspec.core.url_to_fs(url)
    return sorted(path[len(root) :].strip("/") for path in files.find(root))


@pytest.mark.parametrize("name", ["coco", "kitti", "webdataset"])
def test_a_url_gets_the_files_that_a_folder_gets(
    rendered: Dataset, tmp_path: Path, name: str
) -> None:
    url = f"memory://{tmp_path.name}/out"
    counts = export_dataset(rendered, name, url)
    assert counts == export_dataset(rendered, name, tmp_path / "out")
    assert objects_below(url) == files_below(tmp_path / "out")


def test_a_file_url_is_a_folder(rendered: Dataset, tmp_path: Path) -> None:
    export_dataset(rendered, "tum", f"file://{tmp_path}/out")
    assert set(COMMON) <= set(files_below(tmp_path / "out"))
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_command_exports_a_set_at_a_url_beside_its_shards(tmp_path: Path) -> None:
    url = f"memory://{tmp_path.name}/set"
    write_rendered_dataset(url, {0: "train"}, views=1)
    export(url, ["tum"])
    exported = _names(f"{url}/exports/tum")
    assert set(COMMON) <= set(exported)
    assert "world_000000_camera/groundtruth.txt" in exported
    assert open_dataset(url).worlds == (0,)
    with pytest.raises(InvalidInputError, match="does not exist or is empty"):
        export(url, ["tum"])


def test_an_upload_that_fails_leaves_nothing(
    rendered: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"memory://{tmp_path.name}/out"
    writing = RemotePlace.writing

    def full(place: RemotePlace, name: str) -> Any:
        if name == "frames.csv":
            raise RenderError("no room")
        return writing(place, name)

    monkeypatch.setattr(RemotePlace, "writing", full)
    with pytest.raises(RenderError, match="no room"):
        export_dataset(rendered, "tum", url)
    assert _names(url) == []
    monkeypatch.undo()
    export_dataset(rendered, "tum", url)
    assert "README.md" in _names(url)


@pytest.mark.long
def test_a_data_set_on_an_s3_server_is_exported_there(bucket: str) -> None:
    write_rendered_dataset(f"{bucket}/set", {0: "train", 1: "val"}, views=1)
    result = CliRunner().invoke(
        dataset_app, ["export", f"{bucket}/set", "--format", "webdataset"], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    place = open_place(f"{bucket}/set/exports/webdataset")
    for name in (*COMMON, "train-000000.tar", "val-000000.tar", "index.parquet"):
        assert place.exists(name), name
    assert not place.is_empty()
    export(f"{bucket}/set", ["tum"], out=f"{bucket}/tum", split="val")
    poses = open_place(f"{bucket}/tum").read("world_000001_camera/groundtruth.txt")
    assert poses.startswith(b"# timestamp tx ty tz")
