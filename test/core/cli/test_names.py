"""docs/names.md lists what the code knows."""

from __future__ import annotations

import re

import pytest
import yaml
from repository import REPOSITORY

from oaisys_core.cli.names import SKY_MODELS, measure_relief_m, names_text
from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.environment import SkyConfig
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.world.config_files import name_faults

PAGE = (REPOSITORY / "docs" / "names.md").read_text(encoding="utf-8")
RELIEF = re.compile(r"^\| `(\w+)` \| (\S+) m \| ", re.MULTILINE)


def relief_on_page() -> dict[str, float]:
    terrains = PAGE.partition("## Textures")[0]
    return {name: float(relief) for name, relief in RELIEF.findall(terrains)}


def test_the_page_is_that_of_the_code() -> None:
    assert relief_on_page().keys() == PRESETS.keys()
    assert names_text(relief_on_page()) == PAGE, "run `make schema`"


def test_reliefs_on_the_page_are_those_of_the_terrains() -> None:
    """Of two terrains that take a tenth of a second; `make schema` measures all."""
    measured = measure_relief_m(["canyon", "mountain_1"])
    shown = {name: relief_on_page()[name] for name in measured}
    assert shown == pytest.approx(measured, abs=0.05)


def test_the_recipes_are_valid_configurations() -> None:
    recipes = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert len(recipes) == 2
    for recipe in recipes:
        assert name_faults(config_from_mapping(yaml.safe_load(recipe))) == []


def test_every_sky_is_named() -> None:
    values = SkyConfig.model_json_schema()["properties"]["model"]["anyOf"]
    assert set(SKY_MODELS) == {each for value in values for each in value.get("enum", ["overcast"])}
