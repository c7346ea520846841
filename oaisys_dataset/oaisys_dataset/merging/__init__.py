"""Makes one data set of several."""

from oaisys_dataset.merging.merge import MergedWorlds, merge_datasets

__all__ = ["MergedWorlds", "merge_datasets"]
