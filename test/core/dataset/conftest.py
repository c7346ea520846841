"""A data set that all tests of this folder may read."""

from __future__ import annotations

import pytest
from rendered_datasets import write_rendered_dataset

from oaisys_core.dataset import Dataset, open_dataset


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three worlds of two views each, rendered by the analytic backend; not to be changed."""
    folder = tmp_path_factory.mktemp("rendered") / "set"
    write_rendered_dataset(folder)
    return open_dataset(folder)
