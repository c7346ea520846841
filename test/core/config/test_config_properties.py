"""Random configurations: the same seed gives the same bytes, whatever else is drawn."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from config_strategies import configs, digest
from hypothesis import HealthCheck, given, settings
from repository import HELPERS

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.world.module import Metadata, Module, World

Json = dict[str, Any]
BOUNDED = settings(
    max_examples=3,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)


class Greedy(Module):
    """Draws much, and changes nothing."""

    name = metadata_part = "greedy"

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        rng.normal(size=1000)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        rng.normal(size=1000)


class OtherProcess:
    """Another process that answers configurations with hashes."""

    def __init__(self) -> None:
        code = (
            "import sys, json; sys.path.insert(0, sys.argv[1])\n"
            "from config_strategies import digest\n"
            "for line in sys.stdin: print(digest(json.loads(line)), flush=True)"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, str(HELPERS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def begin(self, data: Json) -> None:
        """Have it find the hash of a configuration's images, which `digest` returns."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(data) + "\n")
        self.process.stdin.flush()

    def digest(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


@pytest.fixture(scope="module")
def other() -> Iterator[OtherProcess]:
    other = OtherProcess()
    yield other
    assert other.process.stdin is not None
    other.process.stdin.close()
    other.process.wait(timeout=60)


@pytest.mark.long
@given(data=configs())
@BOUNDED
def test_two_processes_render_the_same_bytes_of_a_seed_whatever_module_is_added(
    other: OtherProcess, data: Json
) -> None:
    other.begin(data)
    here = digest(data, Greedy())
    assert digest({**data, "seed": data["seed"] + 1}) != here
    assert other.digest() == here


@pytest.mark.long
@given(data=configs())
@settings(BOUNDED, max_examples=2)
def test_adding_a_group_does_not_move_the_others(data: Json) -> None:
    further = {"name": "further", "shape": "pebble", "label": "further", "semantic_id": 300}
    groups = [*data["assets"]["groups"], {**further, "count": [5, 5], "variants": 1}]
    more = {**data, "assets": {**data["assets"], "groups": groups}}
    before, after = (Simulation(config_from_mapping(d)) for d in (data, more))
    for simulation in (before, after):
        simulation.step_batch()
    poses = {p.T_map_object.tobytes() for p in after.scene.placements}
    assert all(p.T_map_object.tobytes() in poses for p in before.scene.placements)
