"""Values of an original configuration that have another form are refused by their key's path."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from original_config import Json, document, space, write

from oaisys_core.errors import ConfigError
from oaisys_core.importing import forms, key_outcomes
from oaisys_core.importing.document import key_paths
from oaisys_core.importing.forms import CHECKS, form_of
from oaisys_core.importing.importer import import_file
from oaisys_core.importing.key_outcomes import outcome_of

ODD: tuple[Any, ...] = ("many", [], [[[]]], [1e400], -1e200, 10**400, 1e-320, {"x": 1}, True, None)


def table(module: Any, name: str) -> Json:
    path = Path(module.__file__).with_name(name)
    found: Json = yaml.safe_load(path.read_text(encoding="utf-8"))
    return found


def test_each_key_that_is_mapped_has_a_form_and_no_other_has() -> None:
    for section, kinds in table(key_outcomes, "keys.yaml").items():
        for names in kinds.get("mapped", {}).values():
            for name in names:
                key = f"{section}.{name}".replace("*", "").replace("?", "_")
                assert form_of(key), key
    for section, of_section in table(forms, "forms.yaml").items():
        assert set(of_section) <= set(CHECKS), section
        for names in of_section.values():
            for name in names:
                outcome = outcome_of(f"{section}.{name}")
                assert outcome is not None, name
                assert outcome.kind == "mapped", name


@pytest.mark.parametrize(
    ("place", "value", "error"),
    [
        (
            ("SIMULATION_SETUP", "numBatches"),
            "many" * 100,
            f"SIMULATION_SETUP.numBatches: received '{'many' * 19}..., expected a whole number",
        ),
        (
            ("SIMULATION_SETUP", "numBatches"),
            [1, 2],
            "SIMULATION_SETUP.numBatches: received [1, 2], expected a whole number",
        ),
        (
            ("SIMULATION_SETUP", "numBatches"),
            2.5,
            "SIMULATION_SETUP.numBatches: received 2.5, expected a whole number",
        ),
        (
            ("SENSOR_SETUP", "SENSORS", 0, "sensorParams", "KMatrix"),
            [1],
            "SENSOR_SETUP.SENSORS[0].sensorParams.KMatrix: received [1], expected 9 numbers",
        ),
        (
            ("SENSOR_SETUP", "GENERAL", "hoverBaseModeEnabled"),
            "false",
            "SENSOR_SETUP.GENERAL.hoverBaseModeEnabled: received 'false', expected true or false",
        ),
        (
            ("SENSOR_SETUP", "SENSORS"),
            {"type": "SensorCameraRGBD"},
            "SENSOR_SETUP.SENSORS: received {'type': 'SensorCameraRGBD'}, expected a list of",
        ),
        (
            ("RENDER_SETUP",),
            [{}],
            "RENDER_SETUP: received [{}], expected an object",
        ),
    ],
)
def test_the_key_the_value_and_what_was_expected_are_named(
    place: tuple[str | int, ...], value: Any, error: str, tmp_path: Path
) -> None:
    data = document()
    put(data, place, value)
    path = write(data, tmp_path)
    with pytest.raises(ConfigError) as refused:
        import_file(path)
    assert str(refused.value).startswith(f"{path}: {error}")


def test_texts_of_templates_have_the_same_forms(tmp_path: Path) -> None:
    data = document()
    (layer,) = data["ASSET_SETUP"]["MATERIALS"][0]["materialParams"]["terrainTextureList"]
    layer["templatePath"] = "red.json"
    path = write(data, tmp_path)
    for text, said in (
        ('{"size": "big"}', "terrainTextureList.size|red.json: size: received 'big', expected a"),
        ("[1]", "received [1], expected an object"),
        ("{", "is not a readable JSON file"),
    ):
        (tmp_path / "red.json").write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError) as refused:
            import_file(path, tmp_path)
        assert any(each in str(refused.value) for each in said.split("|"))
        assert "red.json" in str(refused.value)


def test_what_is_not_read_may_have_any_form(tmp_path: Path) -> None:
    data = document()
    data["SENSOR_SETUP"]["SENSORS"].append({"type": "Radar", "sensorParams": {"KMatrix": "none"}})
    data["SENSOR_SETUP"]["GENERAL"]["MESH_FOLLOWER"] = "none"
    data["ASSET_SETUP"]["STAGES"][0]["stageParams"]["landscapeParams"] = 7
    data["RENDER_POST_PROCESSING_EFFECTS_SETUP"]["POST_EFFECTS"] = None
    import_file(write(data, tmp_path))


@pytest.mark.parametrize("world", [document, space])
def test_odd_values_are_read_or_refused_by_their_key(world: Any, tmp_path: Path) -> None:
    for number, place in enumerate(places(world())):
        value = ODD[number % len(ODD)]
        data = world()
        put(data, place, value)
        try:
            import_file(write(data, tmp_path))
        except ConfigError as error:
            names = [name for name in place if isinstance(name, str)]
            assert names[-1] in str(error), (place, value)  # noqa: PT017
            assert "expected" in str(error), (place, value)  # noqa: PT017


def places(node: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the way to each value of a document that is read."""
    if at and form_of(".".join(name for name in at if isinstance(name, str))):
        yield at
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in items:
        if isinstance(value, dict | list):
            yield from places(value, (*at, key))
        elif form_of(".".join(name for name in (*at, key) if isinstance(name, str))):
            yield (*at, key)


def put(data: Any, place: tuple[str | int, ...], value: Any) -> None:
    for name in place[:-1]:
        data = data[name]
    data[place[-1]] = value


def test_places_are_those_of_values_that_are_read() -> None:
    keys = {".".join(name for name in place if isinstance(name, str)) for place in places(space())}
    assert keys <= set(key_paths(json.loads(json.dumps(space()))))
    assert len(keys) > 60
