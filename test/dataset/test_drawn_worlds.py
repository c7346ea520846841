"""A data set whose worlds draw their terrain, light and haze: recorded, checked and repeated."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_datasets import SMALL, render_dataset

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_dataset import open_dataset
from oaisys_dataset.check import check_dataset
from oaisys_dataset.repeat import repeat_records

DRAWN = {
    **SMALL,
    "stage": {
        **SMALL["stage"],
        "surroundings": "land",
        "preset": ["mounds", "canyon", "dunes"],
        "relief_m": [1, 4],
    },
    "environment": {"sky": {"glow_deg": [5, 20]}, "haze": [None, {"visibility_m": [50, 90]}]},
    "sensors": {
        **SMALL["sensors"],
        "motion": {"choose": [SMALL["sensors"]["motion"], {"kind": "grid", "altitude_m": [6, 9]}]},
    },
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drawn") / "set"
    render_dataset(folder, dict.fromkeys(range(3), "train"), 1, DRAWN)
    return folder


@pytest.mark.long
def test_what_was_drawn_is_in_the_manifest_and_the_check_passes(folder: Path) -> None:
    dataset = open_dataset(folder)
    drawn = {record.world: record.metadata["drawn"] for record in dataset.records}
    assert len({world["stage.preset"] for world in drawn.values()}) > 1
    assert len({world["stage.relief_m"] for world in drawn.values()}) == 3
    assert all(1 <= world["stage.relief_m"] <= 4 for world in drawn.values())
    for record in dataset.records:
        told = json.loads(record.provenance["metadata_json"])
        assert told["drawn"] == record.metadata["drawn"]
    assert check_dataset(folder, worlds_rebuilt=2).findings == ()


def test_a_frame_of_a_drawn_world_is_rendered_again_from_its_line(folder: Path) -> None:
    ids = ["000002_0000_camera", "000000_0000_camera"]
    for _, comparisons in repeat_records(open_dataset(folder), ids, 40.0):
        assert all(each.is_equal for each in comparisons)


def test_a_world_that_draws_nothing_has_the_lines_that_it_had(tmp_path: Path) -> None:
    render_dataset(tmp_path, {0: "train"}, 1)
    (record,) = open_dataset(tmp_path).records
    assert record.metadata == {}
    assert record.provenance["metadata_json"] == "{}"


def test_a_batch_that_fails_leaves_the_world_and_what_it_drew() -> None:
    simulation = Simulation(config_from_mapping({**DRAWN, "sensors": SMALL["sensors"]}))
    simulation.step_batch(seed=1)
    drawn, seed = dict(simulation.draws), simulation.batch_seed
    unknown = ModuleMetadata(asset={"groups": {"nothing": {"count_factor": 2}}})
    with pytest.raises(InvalidInputError):
        simulation.step_batch(unknown, seed=2)
    with pytest.raises(InvalidInputError):
        simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": "nowhere"}}), seed=2)
    assert (simulation.draws, simulation.batch_seed) == (drawn, seed)


def test_a_kept_stage_keeps_what_was_drawn_for_it() -> None:
    simulation = Simulation(config_from_mapping(DRAWN))
    simulation.step_batch(seed=5)
    first = dict(simulation.draws)
    simulation.step_batch(seed=6, reuse_stage=True)
    second = dict(simulation.draws)
    assert second["stage.relief_m"] == first["stage.relief_m"]
    assert second["stage.preset"] == first["stage.preset"]
    assert second["environment.sky.glow_deg"] != first["environment.sky.glow_deg"]
