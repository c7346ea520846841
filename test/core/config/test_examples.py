"""Every example configuration runs, small, in every backend that it can have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from repository import REPOSITORY

from oaisys_core.config import load_config
from oaisys_core.types import modality_spec, semantic_level

CONFIG = REPOSITORY / "config"
EXAMPLES = sorted(CONFIG.glob("examples/*.yaml"))
TOPICS = sorted({path.stem.partition("_")[0] for path in EXAMPLES})
SAMPLES = 2
STILL = {"materials", "stage", "textures"}
"""Topics whose second sample would show what the first one does."""


def check(name: str, samples: int, found: dict[str, Any]) -> None:
    """What holds for the images of any example."""
    labels = {0, *found["labels"]}
    assert len(found["samples"]) == samples
    assert any(frames for frames in found["samples"]), f"{name}: nothing was rendered"
    for frames in found["samples"]:
        for sensor, modality, data in frames:
            where = f"{name}: {sensor}/{modality}"
            spec = modality_spec(modality)
            assert data.dtype == spec.dtype, where
            assert data.shape[2:] == (() if spec.channels == 1 else (spec.channels,)), where
            assert data.shape[0] * data.shape[1] <= 64 * 64, where
            if semantic_level(modality) is not None:
                assert set(np.unique(data).tolist()) <= labels, where
            if modality == "depth":
                assert (data > 0).all(), where
            if modality == "rgb":
                assert data.std() > 1, f"{where} is one colour"
    for scans in found["scans"]:
        for sensor, points, _ in scans:
            where = f"{name}: {sensor}"
            assert len(points) > 1000, where
            assert ((points["intensity"] >= 0) & (points["intensity"] <= 255)).all(), where
            if "label" in points.dtype.names:
                assert set(np.unique(points["label"]).tolist()) <= labels, where


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_is_valid_and_says_what_it_shows(path: Path) -> None:
    load_config(path)
    assert path.read_text(encoding="utf-8").startswith("# ")


@pytest.mark.long
@pytest.mark.blender
@pytest.mark.parametrize("topic", TOPICS)
def test_examples_render(topic: str) -> None:
    paths = [path for path in EXAMPLES if path.stem.partition("_")[0] == topic]
    assert paths
    samples = 1 if topic in STILL else SAMPLES
    for path in paths:
        # A job each: its deadline is for one example.
        found = in_blender("examples.rendered", [str(path)], samples)[path.stem]
        check(path.stem, samples, found)
