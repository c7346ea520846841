"""Worlds draw values of their configuration: ranges, choices and variants."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from repository import REPOSITORY
from typer.testing import CliRunner

from oaisys_core.cli.commands import config_app
from oaisys_core.config import (
    SimulationConfig,
    canonical_json,
    config_from_mapping,
    config_sha256,
    load_config,
)
from oaisys_core.config.draws import WORLD
from oaisys_core.config.worlds import WorldSeeds, draw_world
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.files.yaml_documents import parse_yaml
from oaisys_core.world.config_files import name_faults

Json = dict[str, Any]
EXAMPLES = sorted((REPOSITORY / "config/examples").glob("*.yaml"))

HILLS: Json = {
    "stage": {"preset": ["mounds", "canyon"], "relief_m": [1, 8], "resolution_px": [65, 129]},
    "environment": {"haze": [None, {"visibility_m": [50, 100]}], "ground_beyond": [True, False]},
    "assets": {
        "groups": [
            {
                "name": "grass",
                "count": [1, 5],
                "shape": ["grass", "fern"],
                "label": "plant",
                "semantic_id": 40,
                "probability": [0.2, 0.9],
            }
        ]
    },
}


def drawn(data: Json, seed: int) -> Json:
    return dict(draw_world(config_from_mapping(data), WorldSeeds.of(seed)).drawn)


def test_each_world_draws_its_terrain_its_light_and_its_plants() -> None:
    worlds = [drawn(HILLS, seed) for seed in range(60)]
    assert {world["stage.preset"] for world in worlds} == {"mounds", "canyon"}
    relief_m = [world["stage.relief_m"] for world in worlds]
    assert min(relief_m) >= 1
    assert max(relief_m) <= 8
    assert max(relief_m) - min(relief_m) > 5
    assert all(type(world["stage.resolution_px"]) is int for world in worlds)
    assert {world["environment.haze"] is None for world in worlds} == {True, False}
    assert {world["environment.ground_beyond"] for world in worlds} == {True, False}
    assert {world["assets.groups.0.shape"] for world in worlds} == {"grass", "fern"}


def test_a_world_s_configuration_has_what_was_drawn_and_nothing_left_to_draw() -> None:
    world = draw_world(config_from_mapping(HILLS), WorldSeeds.of(7))
    assert not world.config.draws
    assert world.config.stage.relief_m == world.drawn["stage.relief_m"]
    # A range of the simulator's own stays one: each batch, or view, draws from it.
    haze = next(
        found
        for seed in range(9)
        if (found := draw_world(config_from_mapping(HILLS), WorldSeeds.of(seed))).config
        if found.config.environment.haze
    )
    assert haze.config.environment.haze is not None
    assert haze.config.environment.haze.visibility_m == (50.0, 100.0)


def test_a_draw_more_changes_no_other_draw() -> None:
    more = {
        **HILLS,
        "stage": {"roughness": [0, 1], **HILLS["stage"]},
        "assets": {
            "rocks": [],
            "groups": [
                {"name": "first", "count": [0, 1], "shape": "boulder"}
                | {"label": "rock", "semantic_id": 10, "sink": [0, 0.1], "spacing": [0.5, 1.0]},
                *HILLS["assets"]["groups"],
            ],
        },
    }
    before, after = drawn(HILLS, 3), drawn(more, 3)
    assert after.pop("stage.roughness") <= 1
    assert after.pop("assets.groups.0.spacing") >= 0.5
    of_grass = {key.replace("groups.1", "groups.0"): value for key, value in after.items()}
    assert of_grass == before


def test_a_configuration_with_draws_survives_json() -> None:
    config = config_from_mapping(HILLS)
    again = config_from_mapping(json.loads(canonical_json(config)))
    assert again.draws == config.draws
    assert config_sha256(again) == config_sha256(config)
    assert config_sha256(config) != config_sha256(config_from_mapping({}))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_what_draws_nothing_has_the_bytes_that_it_had(path: Path) -> None:
    config = load_config(path)
    if config.draws or config.variants:
        pytest.skip("draws something")
    assert "variants" not in json.loads(canonical_json(config))
    assert draw_world(config, WorldSeeds.of(5)).config is config


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_any_value_of_a_world_may_be_drawn(path: Path) -> None:
    """Each value as the only one to choose from gives the same configuration."""
    config = load_config(path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    choices = {name: _as_choices(value) if name in WORLD else value for name, value in data.items()}
    found = config_from_mapping(choices, path.parent)
    if config.draws or config.variants:
        return
    assert bool(found.draws) == any(name in WORLD for name in data)
    assert draw_world(found, WorldSeeds.of(1)).config == config


def _as_choices(value: Any) -> Any:
    """Return data with each number, name and item as a choice of one."""
    if isinstance(value, dict):
        return {
            key: each if key in ("kind", "radius_m", "effect", "effects") else _as_choices(each)
            for key, each in value.items()
        }
    if isinstance(value, list):
        return [_as_choices(each) for each in value]
    return {"choose": [value]}


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (
            {"stage": {"relief_m": [8, 1]}},
            "stage.relief_m: received [8, 1], expected [least, most]",
        ),
        (
            {"stage": {"relief_m": [1, 2, 3]}},
            "stage.relief_m: received [1, 2, 3], expected a value",
        ),
        ({"stage": {"relief_m": [5]}}, "stage.relief_m: received [5], expected a value"),
        ({"stage": {"relief_m": []}}, "stage.relief_m: received [], expected a value"),
        ({"stage": {"relief_m": {"choose": [1, -8]}}}, "stage.relief_m.choose.1: received -8"),
        ({"stage": {"relief_m": [1, 1e9]}}, "stage.relief_m.1: received 1000000000.0, expected"),
        ({"stage": {"body": ["earth", "pluto"]}}, "stage.body.1: received 'pluto', expected"),
        (
            {"stage": {"resolution_px": [65, 99.5]}},
            "resolution_px.1: received 99.5, expected a whole",
        ),
        ({"stage": {"preset": {"range": [1, 2]}}}, "stage.preset.range: received [1, 2], expected"),
        (
            {"stage": {"water": [None, {"level_share": 0.1, "semantic_id": 30, "wave": 1}]}},
            "stage.water.1.wave: received 1, expected one of the keys",
        ),
        (
            {"stage": {"relief_m": {"choose": [1, 2], "weights": [1]}}},
            "stage.relief_m.weights: received [1], expected 2 numbers from 1e-12 to 1e+12",
        ),
        ({"render": {"quality": ["high", "final"]}}, "render.quality: received ['high', 'final']"),
        (
            {"materials": {"layers": [{"label": ["a", "b"], "semantic_id": 1}]}},
            "label.1: received 'b', expected one name for semantic_id 1, not 'a' and 'b'",
        ),
        (
            {"variants": [{"name": "a", "stage": {"relief_m": -1}}]},
            "variants.0.stage.relief_m: received -1",
        ),
        ({"variants": [{"name": "a", "render": {}}]}, "variants.0.render: unknown key"),
        (
            {
                "variants": [
                    {"name": n, "materials": {"layers": [{"label": n, "semantic_id": 7}]}}
                    for n in ("sand", "snow")
                ]
            },
            "variants.1: received 'snow', expected one name for semantic_id 7",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused_at_its_place(data: Json, expected: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected)):
        config_from_mapping(data)


@pytest.mark.parametrize("text", ["1e2", "1.0e2", "-.5", "[1e0, 2e0]"])
def test_numbers_that_yaml_1_1_takes_for_text_are_those_of_a_range(text: str) -> None:
    section = parse_yaml(f"environment: {{sun_azimuth_deg: {text}}}")
    expected = json.loads(text.replace("-.", "-0."))
    found = config_from_mapping(section).environment.sun_azimuth_deg
    assert found == (tuple(expected) if isinstance(expected, list) else (expected, expected))


@pytest.mark.parametrize("value", ["abc", None, {"a": 1}, "1e3x"])
def test_what_is_no_range_is_told_what_a_range_is(value: object) -> None:
    expected = rf"sky_strength: received {re.escape(repr(value))}, expected a number or \[least"
    with pytest.raises(ConfigError, match=expected):
        config_from_mapping({"environment": {"sky_strength": value}})


@pytest.mark.parametrize("least_most", [[-1e308, 1e308], [0, 10**399]], ids=["inf", "1e399"])
def test_a_range_without_a_finite_width_is_refused(least_most: list[float]) -> None:
    motion = {"kind": "random", "position_m": [0, 0, 2], "roll_deg": least_most}
    with pytest.raises(ConfigError, match=r"motion\.roll_deg(\.1)?: received .*, expected"):
        config_from_mapping({"sensors": {"motion": motion}})
    drawn_from = {"range": least_most}
    with pytest.raises(ConfigError, match=r"stage\.dem\.scale\.range: received .*, expected"):
        config_from_mapping({"stage": {"dem": {"file": "a.tif", "scale": drawn_from}}})


WITHOUT_SUM = [1e308, 10**399, 5e-324, 0, -1]
"""Weights whose sum is no number to draw by; the second is a whole number without a float."""


@pytest.mark.parametrize("weight", WITHOUT_SUM, ids=["1e308", "1e399", "5e-324", "0", "-1"])
def test_weights_that_have_no_sum_are_refused(weight: float) -> None:
    choice = {"choose": [1, 2], "weights": [weight, weight]}
    variants = [{"name": name, "weight": weight} for name in "ab"]
    expected = r"stage\.relief_m\.weights: received .*, expected 2 numbers from 1e-12 to 1e\+12"
    with pytest.raises(ConfigError, match=expected):
        config_from_mapping({"stage": {"relief_m": choice}})
    expected = r"^config: variants\.0\.weight: received .*, expected a number"
    with pytest.raises(ConfigError, match=expected):
        config_from_mapping({"variants": variants})
    layers = [{"label": "sand", "semantic_id": 1, "share": weight} for _ in range(2)]
    with pytest.raises(ConfigError, match=r"share: received .*, expected a number"):
        config_from_mapping({"materials": {"layers": layers}})


def test_worlds_are_drawn_by_the_largest_weights() -> None:
    values = 400 * [2] + 400 * [3]
    data = {"stage": {"relief_m": {"choose": values, "weights": [1e12] * len(values)}}}
    found = [drawn(data, seed)["stage.relief_m"] for seed in range(20)]
    assert set(found) == {2, 3}


def test_the_names_of_all_choices_are_checked() -> None:
    (fault,) = name_faults(config_from_mapping({"stage": {"preset": ["mounds", "canyn"]}}))
    assert fault.startswith("stage.preset: received 'canyn'")
    assert "did you mean canyon" in fault
    layer = {"texture": ["sand", "snad"], "label": "s", "semantic_id": 1}
    variants = [{"name": "a", "materials": {"layers": [layer]}}]
    (fault,) = name_faults(config_from_mapping({"variants": variants}))
    assert "received 'snad'" in fault


def test_values_that_do_not_fit_together_are_found() -> None:
    sun = {"date_time": "2026-06-21T12:00:00+02:00", "latitude_deg": 50, "longitude_deg": 10}
    data = {
        "stage": {"body": ["earth", 2.6e6]},
        "environment": {"sun_from_time": [None, sun]},
    }
    (fault,) = name_faults(config_from_mapping(data))
    assert "ephemerides are for earth, moon and mars, and stage.body is 2600000" in fault
    with pytest.raises(InvalidInputError, match="ephemerides are for"):
        [drawn(data, seed) for seed in range(20)]


def test_variants_are_drawn_by_their_weights(tmp_path: Path) -> None:
    (tmp_path / "moon.yaml").write_text("stage: {preset: craters, body: moon}\nseed: 4\n")
    data = {
        "stage": {"extent_m": 20, "relief_m": [1, 2]},
        "variants": [
            {"name": "earth", "weight": 3},
            {"name": "moon", "file": "moon.yaml"},
            {"name": "flat", "weight": 1, "stage": {"preset": "plane", "relief_m": 0}},
        ],
    }
    (tmp_path / "set.yaml").write_text(yaml.safe_dump(data))
    config = load_config(tmp_path / "set.yaml")
    worlds = [draw_world(config, WorldSeeds.of(seed)) for seed in range(80)]
    by_name = {world.drawn["variant"]: world for world in worlds}
    assert sum(world.drawn["variant"] == "earth" for world in worlds) in range(36, 60)
    assert by_name["moon"].config.stage.body == "moon"
    assert by_name["moon"].config.stage.extent_m == 64.0  # of the other file
    assert by_name["flat"].config.stage.relief_m == 0
    assert by_name["flat"].config.stage.extent_m == 20
    assert 1 <= by_name["earth"].drawn["stage.relief_m"] <= 2
    (tmp_path / "moon.yaml").unlink()  # what was read is in the configuration
    again = config_from_mapping(json.loads(canonical_json(config)))
    assert config_sha256(again) == config_sha256(config)


def test_files_that_may_be_chosen_are_relative_to_the_configuration(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n")
    (tmp_path / "set.yaml").write_text("stage: {mesh: [null, {file: a.obj}]}\n")
    found = json.loads(canonical_json(load_config(tmp_path / "set.yaml")))
    assert found["stage"]["mesh"]["choose"][1]["file"] == str(tmp_path / "a.obj")


def test_the_command_shows_what_a_world_has_drawn(tmp_path: Path) -> None:
    file = tmp_path / "set.yaml"
    file.write_text(yaml.safe_dump(HILLS))
    show = ["show", "--config", str(file)]
    whole = json.loads(CliRunner().invoke(config_app, show).output)
    assert whole["stage"]["preset"] == {"choose": ["mounds", "canyon"]}
    assert whole["stage"]["relief_m"] == {"range": [1.0, 8.0]}
    one = json.loads(CliRunner().invoke(config_app, [*show, "--world", "2"]).output)
    assert one["stage"]["preset"] in ("mounds", "canyon")
    assert isinstance(one["stage"]["relief_m"], float)
    assert SimulationConfig.model_validate(one).draws == {}
