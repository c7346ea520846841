"""What a data set says of itself, beside its shards."""

from __future__ import annotations

from pathlib import Path

import mlcroissant
import pytest
from rendered_datasets import write_rendered_dataset
from synthetic_datasets import write_dataset

from oaisys_core.files.markdown import escape_markdown
from oaisys_dataset import open_dataset
from oaisys_dataset.card.description import describe_dataset
from oaisys_dataset.card.statistics import sample_indices, statistics_of
from oaisys_dataset.cli.export import describe
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.manifest import WorldLegend


def test_a_data_set_describes_itself_and_stays_readable(tmp_path: Path) -> None:
    write_rendered_dataset(tmp_path, {0: "train"})
    describe(str(tmp_path), "CC0-1.0")
    dataset = open_dataset(tmp_path)
    assert "shards/world_000012.tar" in (tmp_path / "README.md").read_text()
    assert "CC0-1.0" in (tmp_path / "data_card.html").read_text()
    described = mlcroissant.Dataset(tmp_path / "croissant.json")
    names = [row["frames/frame_id"].decode() for row in described.records("frames")]
    assert names == [record.frame_id for record in dataset.records]


def test_statistics_are_those_of_the_pixels(tmp_path: Path) -> None:
    write_rendered_dataset(tmp_path, {0: "train", 1: "val"})
    dataset = open_dataset(tmp_path)
    found = statistics_of(dataset)
    pixels = 0
    shares = dict.fromkeys(found.class_shares, 0.0)
    for sample in dataset:
        names = {0: "", **dataset.legend(sample.record.world).labels}
        ids = sample.arrays["semantic_0"]
        pixels += ids.size
        for label_id, name in names.items():
            if (ids == label_id).any():
                shares[name] += int((ids == label_id).sum())
    assert found.class_shares == {name: count / pixels for name, count in shares.items()}
    assert found.frames == {"train": 2, "val": 2}
    assert found.worlds == {"train": 1, "val": 1}
    assert found.seconds == 2.0
    assert found.depth_m is not None
    assert found.depth_m.shares.sum() == pytest.approx(1.0, rel=1e-12)
    hit_nothing = sum(float((s.arrays["depth"] == float("inf")).sum()) for s in dataset)
    assert found.no_hit_share == pytest.approx(hit_nothing / pixels, rel=1e-12)


def test_frames_are_sampled_at_equal_distances() -> None:
    assert list(sample_indices(3, 12)) == [0, 1, 2]
    assert list(sample_indices(1001, 3)) == [0, 500, 1000]


HTML = "<img src=x onerror=alert(1)> [click](javascript:alert(1)) | `x`"


def test_html_and_markdown_in_names_of_others_are_shown_as_they_are(tmp_path: Path) -> None:
    write_dataset(tmp_path, {0: "train"}, legend=WorldLegend({1: HTML, 2: HTML}, {}))
    describe_dataset(open_dataset(tmp_path), ExportOptions(license=HTML))
    readme, card = ((tmp_path / name).read_text() for name in ("README.md", "data_card.html"))
    for page in (readme, card):
        assert "&lt;img" in page
        assert "<img src=x" not in page
    assert "[click](" not in readme
    assert "\\| \\`x\\`" in readme


def test_markdown_of_others_is_in_a_line() -> None:
    assert escape_markdown("a\n# b") == "a \\# b"
