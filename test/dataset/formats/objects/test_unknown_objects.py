"""A foreign set whose table has objects that its legend does not know is not exported."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.shards import objects_name


@pytest.mark.parametrize("format_name", ["bop", "kitti_object"])
@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("instance_id", 4_000_000_000, "instance_id: received 4000000000"),
        ("name", "other", "as the legend of the world says"),
        ("label", "other", "as the legend of the world says"),
    ],
)
def test_an_object_that_the_legend_does_not_know_is_refused_by_name(
    known: Dataset, tmp_path: Path, format_name: str, name: str, value: Any, fault: str
) -> None:
    assert known.place.folder is not None
    shutil.copytree(known.place.folder, tmp_path / "set")
    path = tmp_path / "set" / objects_name(1)
    table = pq.read_table(path)
    place = table.schema.get_field_index(name)
    values = [*table[name].to_pylist()[:-1], value]
    field = table.schema.field(name)
    pq.write_table(table.set_column(place, field, pa.array(values, field.type)), path)
    with pytest.raises(InvalidInputError, match=fault) as refused:
        export_dataset(open_dataset(tmp_path / "set"), format_name, tmp_path / "out")
    assert objects_name(1) in str(refused.value)
    assert not (tmp_path / "out").exists()
