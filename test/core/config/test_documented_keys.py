"""Whatever README and docs show of a configuration is accepted: blocks, keys, values, defaults."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Annotated, Any

import pytest
import yaml
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from repository import REPOSITORY

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.config.draws import is_draw
from oaisys_core.config.schema import all_models
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_core.world.config_files import name_faults

PAGES = [
    *(REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((REPOSITORY / "docs").glob("*.md")),
]
NAMES = [path.name for path in PAGES]
MODELS = all_models(SimulationConfig)
SECTIONS = "|".join(SimulationConfig.model_fields)

BLOCK = re.compile(r"```yaml\n(.*?)```", re.DOTALL)
FENCE = re.compile(r"```\w*\n.*?```", re.DOTALL)
KEY = re.compile(rf"`((?:{SECTIONS})(?:\.[a-z_0-9]+)+)(: [^`]+)?`")
METADATA = re.compile(r'`(\{"[^`]*\})`')
MAPPING = re.compile(r"`(?:([a-z_]+): )?(\{[^`\"]*\})`")
NOT_OURS = {"drive.json", "drive.launch.py", "drive.received", "render.threads"}
"""Files, an attribute in Python, and a setting of Blender."""

MISSING_FILE = "region.tif"
"""Of a reader's own, in one example."""


def found_in(pattern: re.Pattern[str]) -> Iterator[Any]:
    """Yield what a pattern finds on all pages, with the page's name."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for match in pattern.finditer(text if pattern is BLOCK else FENCE.sub("", text)):
            values = [" ".join((group or "").split()) for group in match.groups()]
            values = [match.group(1)] if pattern is BLOCK else values
            yield pytest.param(*values, id=f"{page.stem}-{values[-1] or values[0]}"[:60])


@pytest.mark.parametrize("block", found_in(BLOCK))
def test_blocks_are_accepted(block: str) -> None:
    data = yaml.safe_load(block)
    if not accepts(SimulationConfig, data):
        config_from_mapping(data)  # says what is wrong
    if MISSING_FILE not in block:
        assert name_faults(config_from_mapping(data)) == []


@pytest.mark.parametrize(("key", "value"), found_in(KEY))
def test_keys_exist_and_their_values_are_accepted(key: str, value: str) -> None:
    if key in NOT_OURS:
        return
    parts = key.split(".")
    model: Any = SimulationConfig
    for index, part in enumerate(parts):
        options = [each for each in sections_of(model) if part in each.model_fields]
        assert options, f"{'.'.join(parts[:index])} has no key {part}"
        model = options[0].model_fields[part].annotation
    if value:
        data: Any = yaml.safe_load(value.removeprefix(": "))
        for part in reversed(parts):
            data = {part: data}
        config_from_mapping(data)


def sections_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the sections that a type may be or contain."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [each for part in getattr(annotation, "__args__", ()) for each in sections_of(part)]


@pytest.mark.parametrize(("key", "mapping"), found_in(MAPPING))
def test_mappings_are_accepted_by_a_section(key: str, mapping: str) -> None:
    """Such as a layer, or a density; ``label: [a, b]`` was documented and refused."""
    data = yaml.safe_load(mapping)
    if data and all(value is None for value in data.values()):
        return  # keys of a report
    if is_draw(data):
        return  # it may stand for any value
    kinds: list[Any] = list(MODELS.values())
    if key:
        fields = [model.model_fields[key] for model in kinds if key in model.model_fields]
        kinds = [kind_of(field) for field in fields]
    assert kinds, f"no section has the key {key}"
    assert any(accepts(kind, data) for kind in kinds), data


def kind_of(field: FieldInfo) -> Any:
    """Return the type of a key, with its limits."""
    return Annotated[(field.annotation, *field.metadata, None)]


def accepts(kind: Any, data: Any) -> bool:
    """Return whether a type accepts data, files that do not exist apart."""
    try:
        TypeAdapter(kind).validate_python(data)
    except ValidationError as error:
        return all(fault["loc"][-1] in ("file", "folder") for fault in error.errors())
    return True


def test_metadata_are_accepted() -> None:
    """The page's JSON metadata are accepted in a world of the page's own configuration."""
    text = (REPOSITORY / "docs/worlds.md").read_text(encoding="utf-8")
    *_, block = BLOCK.findall(text)
    simulation = Simulation(
        config_from_mapping(
            yaml.safe_load(block)
            | {
                "backend": "analytic",
                "stage": {"resolution_px": 33},
                "assets": {"rocks": []},
                "materials": {"texture_size_px": 16, "mask": {"size_px": 16}},
            }
            | {"sensors": {"cameras": [{"width_px": 8, "height_px": 6, "modalities": ["depth"]}]}}
        )
    )
    simulation.step_batch()
    found = [json.loads(each) for each in METADATA.findall(FENCE.sub("", text))]
    assert len(found) >= 2
    for metadata in found:
        simulation.step_sample(ModuleMetadata(**metadata))


def test_every_default_is_accepted() -> None:
    """Pydantic does not check defaults, and `oaisys config show` prints them to be edited."""
    for name, model in MODELS.items():
        for key, field in model.model_fields.items():
            if field.is_required():
                continue
            kind = TypeAdapter(kind_of(field))
            default = field.get_default(call_default_factory=True)
            shown = kind.dump_python(default, mode="json")
            assert kind.validate_python(shown) == default, f"{name}.{key}"
