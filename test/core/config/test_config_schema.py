"""The published schema and the reference page say what the code checks, key by key."""

import json
from pathlib import Path

import jsonschema
import pytest
import yaml
from repository import REPOSITORY

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.config.reference import reference_text
from oaisys_core.config.schema import all_models, config_schema, descriptions, schema_text
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
