"""A bag whose file is taken away while it is written: nothing is written into nowhere."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic

TOPIC = RecordedTopic("/a", "std_msgs/msg/Empty")
EMPTY = b"\x00\x01\x00\x00\x00"
FAULTS: dict[str, Callable[[Path], object]] = {
    "deleted": lambda file: file.unlink(),
    "folder deleted": lambda file: shutil.rmtree(file.parent),
    "moved": lambda file: file.rename(file.with_suffix(".old")),
    "folder moved": lambda file: file.parent.rename(f"{file.parent}.old"),
    "replaced": lambda file: Path(shutil.copy(file, f"{file}.new")).replace(file),
    "emptied": lambda file: os.truncate(file, 0),
}


def begin(folder: Path) -> tuple[BagWriter, Path]:
    bag = BagWriter(folder)
    bag.add_topic(TOPIC)
    bag.write("/a", EMPTY, 1, 1)
    return bag, folder / f"{folder.name}_0.mcap"


@pytest.mark.ros
@pytest.mark.parametrize("fault", FAULTS)
def test_a_bag_that_is_taken_away_is_neither_written_nor_finished(
    fault: str, tmp_path: Path
) -> None:
    """Messages went into a file without a name, and the bag was closed as if all was well."""
    bag, file = begin(tmp_path / "written")
    FAULTS[fault](file)
    with pytest.raises(OSError, match=str(file.parent)):
        bag.write("/a", EMPTY, 2, 2)

    bag, file = begin(tmp_path / "closed")
    FAULTS[fault](file)
    with pytest.raises(OSError, match=str(file)):
        bag.close()
    assert not (file.parent / "metadata.yaml").exists()
