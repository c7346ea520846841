"""The arithmetic of the benchmark's topic ``dataset``, and one of its jobs as the topic runs it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tools.bench.child import run_job
from tools.bench.figures import Figure
from tools.bench.settings import Settings
from tools.bench.topics.dataset import Pair, growth_mb, limit_s, speed_figures

PLAIN = {
    "batch_s": [6.0, 4.0],
    "sample_s": [[5.0, 1.0, 1.0], [3.0, 1.0, 2.0]],
    "cpu_s": 20.0,
    "encode_cpu_s": {"rgb": [0.01]},
}
DATA = {
    "start_s": 9.0,
    "s": 24.0,
    "compared_s": 11.5,
    "cpu_s": 21.0,
    "frames": 6,
    "bytes": 12_000_000,
}


def by_name(figures: list[Figure]) -> dict[str, Figure]:
    return {each.name: each for each in figures}


def test_batches_and_steady_views_say_what_is_allowed() -> None:
    # The median of 1, 1, 1 and 2 seconds; the first view of each world is not steady.
    assert limit_s(PLAIN) == 10.0 + 6 * 1.0


def test_a_data_set_is_compared_with_a_plain_loop_and_with_what_is_allowed() -> None:
    found = by_name(speed_figures("demo", "preview", [Pair(PLAIN, DATA)]))
    cores = len(os.sched_getaffinity(0))
    stem = "dataset_demo_preview"
    assert found[f"{stem}_frames_per_hour"].median == pytest.approx(900)
    assert found[f"{stem}_frames_per_core_hour"].median == pytest.approx(900 / cores)
    assert found[f"{stem}_core_hours_per_1000"].median == pytest.approx(cores / 0.9)
    assert found[f"{stem}_share"].median == pytest.approx(100 * 16 / 24)
    # After its first two views the loop needs 1 + 4 + 6 seconds.
    assert found[f"{stem}_overhead"].median == pytest.approx(100 * 0.5 / 11)
    assert found[f"{stem}_cpu_overhead"].median == pytest.approx(5)
    assert found[f"{stem}_mb_per_frame"].median == pytest.approx(2)
    assert all(each.goal is None for each in found.values())


def test_worlds_are_added_up_and_only_their_sum_has_goals() -> None:
    slow = Pair(PLAIN, {**DATA, "s": 72.0})
    found = by_name(speed_figures("all", "preview", [Pair(PLAIN, DATA), slow]))
    assert found["dataset_all_preview_frames_per_hour"].median == pytest.approx(12 / 96 * 3600)
    assert found["dataset_all_preview_share"].median == pytest.approx(100 * 32 / 96)
    assert found["dataset_all_preview_share"].is_met is False
    assert found["dataset_all_preview_overhead"].is_met is True
    geometry = by_name(speed_figures("all", "geometry", [slow]))
    assert geometry["dataset_all_geometry_overhead"].goal is None


def test_growth_leaves_out_the_first_worlds() -> None:
    assert growth_mb([500, 900, *[1000.0] * 16, 1010, 1030]) == pytest.approx(20)


@pytest.mark.long
@pytest.mark.system
def test_a_driver_of_many_lines_is_measured(tmp_path: Path) -> None:
    settings = Settings(out=tmp_path, width_px=64, height_px=48)
    said: list[str] = []
    found = run_job(
        "dataset.rendering.driver_memory",
        settings,
        lambda share, text: said.append(text),
        worlds=3,
        views=5,
    )
    assert 0 < found["begun"] < found["peak"] <= found["read"]
    assert "15 lines of manifests" in said
