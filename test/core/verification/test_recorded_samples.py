"""Samples of a record are chosen by the numbers of batch and sample."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.verification.recorded_samples import FolderRecords, choose_ids


@pytest.fixture
def records(tmp_path: Path) -> FolderRecords:
    file = tmp_path / "batch_0001/meta_data/sample_data/0003.json"
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps({"batch_id": 1, "sample_id": 3}))
    return FolderRecords([file], tmp_path)


def test_a_sample_is_chosen_by_its_numbers(records: FolderRecords) -> None:
    assert choose_ids(records, ["1/3"], every=False) == [(1, 3)]


@pytest.mark.parametrize("name", ["1", "/3", "1/", "\u0661/3", f"{'9' * 5000}/3", "1/3/5"])
def test_what_is_no_pair_of_numbers_is_refused(records: FolderRecords, name: str) -> None:
    with pytest.raises(InvalidInputError, match="expected BATCH/SAMPLE, such as 1/3"):
        choose_ids(records, [name], every=False)
