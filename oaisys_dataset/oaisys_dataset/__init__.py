"""Data sets of many worlds: rendered in shards, checked, read, and exported to other formats.

::

    dataset.json                what the data set is (`oaisys_dataset.manifest.DatasetInfo`)
    shards/world_000012.tar     images of a world, and its legend
    shards/world_000012.jsonl   the manifest of that world: one line for each frame; written last,
                                so that it exists only if the shard is whole
    shards/world_000012.scans.jsonl   one line for each lidar scan; only with lidars
    shards/world_000012.objects.parquet   a row for each frame and object; only with object ids
    failed/world_000013.json    why a world could not be made
"""

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:  # as in `python -m oaisys_dataset`
    del sys.path[0]  # the current folder, whose files nothing may import

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset, DatasetSample, open_dataset

__all__ = ["Dataset", "DatasetSample", "open_dataset"]


def __getattr__(name: str) -> Any:
    """Import the reader when it is first used: `oaisys --help` imports this package."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from oaisys_dataset import reader

    return getattr(reader, name)
