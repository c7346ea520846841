"""A large data set is read in little memory."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from synthetic_datasets import dataset_info, write_dataset

from oaisys_dataset import open_dataset
from oaisys_dataset.manifest import FrameRecord
from oaisys_dataset.places import open_place
from oaisys_dataset.shards import HEAD, manifest_name

WORLDS, VIEWS = 100, 1000
MAX_BYTES = 500_000_000

READ = """
import re, sys
from pathlib import Path
from oaisys_dataset import open_dataset
dataset = open_dataset(sys.argv[1])
count = sum(len(record.images) for record in dataset.records)
# `ru_maxrss` would count the process that started this one, too.
most_kb = re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]
print(len(dataset), count, int(most_kb) * 1024)
"""


def lines_of(record: FrameRecord, world: int) -> str:
    """The lines of a world whose frames differ in their places in the data set alone."""
    frame_id = f"{world:06d}_0000_camera"
    line = replace(record, world=world, frame_id=frame_id).to_json()
    parts = re.split(r'("view": ?)0\b', line.replace(record.frame_id, frame_id), maxsplit=1)
    before, key, after = parts
    return "".join(
        f"{before}{key}{view}{after}\n".replace(frame_id, f"{world:06d}_{view:04d}_camera")
        for view in range(VIEWS)
    )


@pytest.mark.soak
def test_a_hundred_thousand_lines_are_read_in_less_than_500_mb(tmp_path: Path) -> None:
    write_dataset(tmp_path / "one", {0: "train"}, views=1)
    (record,) = open_dataset(tmp_path / "one").records
    assert len(record.to_json()) > 1500
    place = open_place(tmp_path / "many")
    place.write(HEAD, dataset_info(WORLDS, VIEWS).to_json().encode())
    for world in range(WORLDS):
        place.write(manifest_name(world), lines_of(record, world).encode())
    command = [sys.executable, "-c", READ, str(tmp_path / "many")]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    frames, images, most_bytes = map(int, result.stdout.split())
    assert (frames, images) == (100_000, 500_000)
    assert most_bytes < MAX_BYTES
