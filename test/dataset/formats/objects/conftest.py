"""A data set of three known objects for the formats of detectors and object poses."""

from __future__ import annotations

import pytest
from object_worlds import object_config
from small_datasets import render_dataset

from oaisys_dataset import Dataset, open_dataset


@pytest.fixture(scope="session")
def known(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two worlds of three views each; not to be changed."""
    folder = tmp_path_factory.mktemp("known")
    render_dataset(folder / "set", {0: "train", 1: "val"}, 3, object_config(folder))
    return open_dataset(folder / "set")
