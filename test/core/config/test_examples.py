"""Every example configuration runs, small: one of each kind of scene in Blender."""

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


def topic_of(path: Path) -> str:
    """Return what its name begins with."""
    return path.stem.partition("_")[0]


TOPICS = sorted({topic_of(path) for path in EXAMPLES})
SAMPLES = 2
STILL = {"materials", "stage", "textures", "world"}
"""Topics whose second sample would show what the first one does."""

IN_BLENDER = {
    *("assets_files", "assets_vegetation", "environment_clouds", "environment_hdri"),
    *("environment_lamps", "materials_anti_tiling", "materials_label_image", "passes_all"),
    *("render_dof_motion_blur", "render_effects", "sensors_rolling_shutter", "sensors_stereo"),
    *("stage_mesh", "stage_river_bed", "textures_alive"),
}
"""One of each kind of scene of which no test of the Blender backend renders what a configuration
makes of it. The others differ in what both backends are given alike, such as the heights of a
preset or the poses of a motion: the analytic backend shows it at a fifth of the cost, and `make
soak` renders them in Blender, too."""


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


def check_topic(topic: str, backends: dict[str, str]) -> None:
    """Render the examples of a topic that have a backend, each with that one."""
    samples = 1 if topic in STILL else SAMPLES
    for path in (path for path in EXAMPLES if topic_of(path) == topic and path.stem in backends):
        # A job each: its deadline is for one example.
        found = in_blender("examples.rendered", [str(path)], samples, backends[path.stem])
        check(path.stem, samples, found[path.stem])


@pytest.mark.long
@pytest.mark.blender
@pytest.mark.parametrize("topic", TOPICS)
def test_examples_render(topic: str) -> None:
    names = [path.stem for path in EXAMPLES]
    assert set(names) > IN_BLENDER
    check_topic(topic, {name: "blender" if name in IN_BLENDER else "analytic" for name in names})


OTHERS = [path for path in EXAMPLES if path.stem not in IN_BLENDER]


@pytest.mark.soak
@pytest.mark.blender
@pytest.mark.parametrize("topic", sorted(set(map(topic_of, OTHERS))))
def test_the_other_examples_render_in_blender(topic: str) -> None:
    check_topic(topic, {path.stem: "blender" for path in OTHERS})
