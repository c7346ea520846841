"""The published schema and the reference page say what the code checks, key by key."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from repository import REPOSITORY

from oaisys_core.config import SimulationConfig, config_from_mapping, config_sha256
from oaisys_core.config.reference import reference_text
from oaisys_core.config.schema import (
    all_models,
    build_schema,
    config_schema,
    descriptions,
    schema_text,
)
from oaisys_core.errors import ConfigError

FILES = (REPOSITORY / "config/simulator.yaml", *REPOSITORY.glob("config/examples/*.yaml"))
VALIDATOR = jsonschema.Draft202012Validator(config_schema())


@pytest.mark.parametrize("name", all_models(SimulationConfig))
def test_every_key_is_described(name: str) -> None:
    model = all_models(SimulationConfig)[name]
    missing = set(model.model_fields) - set(descriptions(model))
    assert not missing, f"add these to the Attributes block of {name}: {missing}"


def test_the_published_files_are_those_of_this_code() -> None:
    message = "run `make schema`"
    published = (REPOSITORY / "config/schema.json").read_text(encoding="utf-8")
    assert published == schema_text(), message
    page = (REPOSITORY / "docs/configuration.md").read_text(encoding="utf-8")
    assert page == reference_text(), message


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(config_schema())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_files_are_valid_and_tell_editors_where_the_schema_is(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    VALIDATOR.validate(_as_json(yaml.safe_load(text)))
    (line,) = [line for line in text.splitlines() if "yaml-language-server" in line]
    assert (path.parent / line.partition("$schema=")[2]).resolve() == (
        REPOSITORY / "config/schema.json"
    )


def test_the_default_world_is_valid_in_full() -> None:
    VALIDATOR.validate(SimulationConfig().model_dump(mode="json"))


@pytest.mark.parametrize(
    "data",
    [
        {"stage": {"extend_m": 3}},
        {"seed": -1},
        {"backend": "unreal"},
        {"sensors": {"cameras": [{"width_px": 0}]}},
        {"sensors": {"cameras": [{"name": "Camera"}]}},
        {"sensors": {"motion": {"kind": "flying"}}},
        {"assets": {"primitives": [{"shape": "sphere", "position_m": [0, 0, 0]}]}},
        {"environment": {"sun_elevation_deg": [0, 91]}},
        {"materials": {"layers": [{"semantic_id": 1}]}},
    ],
)
def test_what_the_code_refuses_the_schema_refuses(data: dict[str, object]) -> None:
    assert not VALIDATOR.is_valid(data)
    with pytest.raises(ConfigError):
        config_from_mapping(data)


@pytest.mark.parametrize(
    "data",
    [
        {"environment": {"sun_elevation_deg": 12}},
        {"environment": {"sun_elevation_deg": [12, 20.5]}},
        {"sensors": {"motion": {"kind": "hover", "height_above_ground_m": [2, 4]}}},
        {"assets": {"primitives": [{"shape": "sphere", "radius_m": 1, "position_m": [0, 0, 0]}]}},
    ],
)
def test_what_the_code_takes_the_schema_takes(data: dict[str, object]) -> None:
    VALIDATOR.validate(data)
    config_from_mapping(data)


def _as_json(data: object) -> object:
    """Return the data as JSON has it: YAML knows dates, JSON only their text."""
    return json.loads(json.dumps(data, default=str))


WITHOUT_KIND = {
    "scan": ({"sensors": {"lidars": [{"scan": {"channels": 16}}]}}, "rotating"),
    "motion": ({"sensors": {"motion": {}}}, "given"),
    "vehicle": ({"drive": {"waypoints_m": [[1, 2]], "vehicle": {"speed_m_s": 2.0}}}, "rover"),
    "a drawn motion": ({"sensors": {"motion": {"choose": [{}]}}}, "given"),
}


@pytest.mark.parametrize(("data", "kind"), WITHOUT_KIND.values(), ids=WITHOUT_KIND)
def test_a_kind_that_is_missing_is_the_default_of_page_and_schema(
    data: dict[str, Any], kind: str
) -> None:
    VALIDATOR.validate(data)
    assert f'| `kind` | `{kind}` | `"{kind}"` |' in reference_text()
    written = yaml.safe_load(json.dumps(data))
    for section in (
        *written.get("sensors", {}).get("lidars", ()),
        written.get("sensors", {}),
        written.get("drive", {}),
    ):
        for key in {"scan", "motion", "vehicle"} & set(section):
            (section[key].get("choose") or [section[key]])[0]["kind"] = kind
    assert config_sha256(config_from_mapping(data)) == config_sha256(config_from_mapping(written))


def kind_unions() -> Iterator[tuple[str, list[str], dict[str, Any]]]:
    """Yield each key whose section is chosen by its kind, the kinds and the schema."""
    definitions = build_schema()["$defs"]
    for name, definition in definitions.items():
        for key, node in definition.get("properties", {}).items():
            chosen = node.get("items", node).get("discriminator")
            if chosen:
                members = [each.rpartition("/")[2] for each in chosen["mapping"].values()]
                without = [
                    each for each in members if "kind" not in definitions[each].get("required", ())
                ]
                yield f"{name}.{key}", without, chosen["mapping"]


def test_of_sections_chosen_by_kind_at_most_one_is_the_default() -> None:
    found = {place: without for place, without, _ in kind_unions()}
    assert found == {
        "DriveConfig.vehicle": ["RoverConfig"],
        "GroupConfig.density": [],
        "LidarConfig.scan": ["RotatingScanConfig"],
        "SensorsConfig.motion": ["GivenMotion"],
    }


def test_a_kind_without_a_default_is_missing_with_the_kinds_there_are() -> None:
    group = {"name": "g", "count": [1, 2], "shape": "grass", "label": "p", "semantic_id": 40}
    data = {"assets": {"groups": [{**group, "density": [{"size_m": 3}]}]}}
    assert not VALIDATOR.is_valid(data)
    (kinds,) = (set(kinds) for place, _, kinds in kind_unions() if place == "GroupConfig.density")
    with pytest.raises(ConfigError, match=r"density\.0\.kind: missing, expected '") as refused:
        config_from_mapping(data)
    assert set(re.findall(r"'(\w+)'", str(refused.value))) == kinds


def test_keys_of_another_kind_are_refused_with_the_default_one() -> None:
    data = {"sensors": {"lidars": [{"scan": {"chanels": 16}}], "motion": {"waypoints_m": []}}}
    with pytest.raises(ConfigError) as refused:
        config_from_mapping(data)
    scan, motion = sorted(str(refused.value).splitlines())
    assert "scan.chanels: unknown key" in scan
    assert "petals" not in scan
    assert "(did you mean channels?) of kind 'rotating', the default" in scan
    assert motion.endswith("one of the keys kind of kind 'given', the default")
