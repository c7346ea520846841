"""What is said of values that do not fit: in words of its own, never in pydantic's."""

from __future__ import annotations

import copy
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError
from repository import REPOSITORY

from oaisys_core.config import SimulationConfig, adjust, config_from_mapping, load_config
from oaisys_core.config.expectations import WORDS
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.world.module import override
from oaisys_core.world.modules import SensorsModule
from oaisys_core.world.modules.assets.metadata import asset_metadata

MOST_CPU_S = 5.0
"""For 5,000 wrong keys: a fifth of what comparing each with all others takes."""

CONFIG = REPOSITORY / "config"
FILES = [CONFIG / "simulator.yaml", *sorted(CONFIG.glob("examples/*.yaml"))]
WRONG: tuple[Any, ...] = (
    *("nonsense", -1, 1e12, None, [], {}, True, 3.5, float("nan"), [1, 2, 3, 4, 5, 6], {"a": 1}),
    *(["a"], "", 0, {"kind": "nonsense"}, {"kind": 3}),
)
PYDANTIC = re.compile(
    r"[Ii]nput|should|Value error|Unable|discriminator|[A-Z]\w+Config\b|required|permitted|<class"
    r"|tuple\[|literal\["
)


def locations(data: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if at:
        yield at
    if isinstance(data, dict):
        children: Any = data.items()
    else:
        children = enumerate(data) if isinstance(data, list) else ()
    for key, value in children:
        yield from locations(value, (*at, key))


def with_value(data: dict[str, Any], at: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """Return the data with another value in one place; all that is beside it is shared."""
    changed = copy.copy(data)
    inner: Any = changed
    for key in at[:-1]:
        inner[key] = inner = copy.copy(inner[key])
    inner[at[-1]] = value
    return changed


def place_of(data: dict[str, Any], at: tuple[Any, ...]) -> tuple[Any, ...]:
    """What a value is: its key, kinds of what is around it, its type; items of a list are alike."""
    kinds, inner = [], data
    for key in at:
        kinds.append(inner.get("kind") if isinstance(inner, dict) else None)
        inner = inner[key]
    keys = [key if isinstance(key, str) else 0 for key in at]
    return (*keys, *map(str, kinds), type(inner))


def cases() -> Iterator[tuple[dict[str, Any], Path]]:
    """A wrong value in the place of each value of the defaults and examples, once of each place.

    What is right is shared by all cases of a file: nobody may change it.
    """
    default = load_config(FILES[0]).model_dump(mode="json")
    seen: set[tuple[Any, ...]] = set()
    for data, file in [
        (default, FILES[0]),
        *((yaml.safe_load(file.read_text(encoding="utf-8")), file) for file in FILES),
    ]:
        for at in locations(data):
            if (place := place_of(data, at)) in seen:
                continue
            seen.add(place)
            for wrong in WRONG:
                yield with_value(data, at, copy.deepcopy(wrong)), file.parent


@pytest.mark.long
def test_whatever_is_wrong_is_told_without_pydantic_s_words() -> None:
    kinds: set[str] = set()
    refused = 0
    for data, base in cases():
        try:
            config_from_mapping(data, base)
        except ConfigError as error:
            refused += 1
            for line in str(error).splitlines():
                said = re.sub(r"received .*, expected", "", line)
                assert not PYDANTIC.search(said), line
            found = error.__cause__
            assert isinstance(found, ValidationError)
            kinds |= {detail["type"] for detail in found.errors(include_input=False)}
    assert refused > 5000
    assert len(kinds) > 15
    assert kinds <= WORDS.keys() | {"value_error"}


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (
            {"render": {"quality": "x"}},
            "received 'x', expected 'geometry', 'draft', 'preview', 'standard', 'high' or 'final'",
        ),
        ({"seed": -1}, "seed: received -1, expected a number of at least 0"),
        ({"seed": "x"}, "seed: received 'x', expected a whole number"),
        (
            {"drive": {"odometry_rate_hz": 1e-10}},
            "drive.odometry_rate_hz: received 1e-10, expected a number of at least 0.0001",
        ),
        ({"stage": 3}, "stage: received 3, expected a mapping of keys to values"),
        ({"stage": {"dem": {}}}, "stage.dem.file: missing, expected a value"),
        ({"stage": {"size": 3}}, "stage.size: unknown key"),
        (
            {"sensors": {"motion": {"kind": "walk"}}},
            "sensors.motion.kind: received 'walk', expected 'given', 'csv', ",
        ),
        (
            {"assets": {"groups": [{"density": [{"size_m": 3}]}]}},
            "assets.groups.0.density.0.kind: missing, expected 'noise', 'voronoi', ",
        ),
        (
            {"sensors": {"motion": {"kind": "hover", "look": "up"}}},
            "sensors.motion.look: received 'up', expected 'forward' or 'down'",
        ),
        (
            {"assets": {"movers": [{"trajectory": {"waypoints_m": [[1], [2, 3]]}}]}},
            "assets.movers.0.trajectory.waypoints_m.0.1: missing, expected a value",
        ),
    ],
)
def test_a_fault_says_what_was_received_and_what_was_expected(
    data: dict[str, Any], line: str
) -> None:
    with pytest.raises(ConfigError) as found:
        config_from_mapping(data)
    assert line in str(found.value)


@pytest.mark.parametrize(
    ("data", "near", "others"),
    [
        ({"sensrs": {}}, "sensors", ["stage", "seed"]),
        ({"sensors": {"camras": []}}, "cameras", ["pose_policy"]),
        ({"stage": {"presett": "plane"}}, "preset", ["extent_m"]),
        ({"sensors": {"cameras": [{}, {"width": 9}]}}, "width_px", ["fx_px"]),
        ({"sensors": {"cameras": [{"lens": {"f_numbr": 4}}]}}, "f_number", ["blades"]),
        ({"sensors": {"motion": {"kind": "hover", "lok": "down"}}}, "look", ["kind"]),
        ({"environment": {"haze": {"visibility": 9}}}, "visibility_m", ["thickness_m"]),
        (
            {"assets": {"groups": [{"density": [{"kind": "height", "rang_m": 1}]}]}},
            "range_m",
            ["fade_m"],
        ),
    ],
)
def test_an_unknown_key_suggests_the_nearest_of_its_own_section(
    data: dict[str, Any], near: str, others: list[str]
) -> None:
    with pytest.raises(ConfigError) as found:
        config_from_mapping(data)
    message = next(line for line in str(found.value).splitlines() if "unknown key" in line)
    assert f"(did you mean {near}?)" in message
    assert all(f"{key}," in message or f", {key}" in message for key in [near, *others])


def test_a_key_of_another_kind_is_not_suggested() -> None:
    motion = {"kind": "hover", "waypoints_m": [[0, 0, 1]]}
    with pytest.raises(ConfigError) as found:
        config_from_mapping({"sensors": {"motion": motion}})
    assert "sensors.motion.waypoints_m: unknown key, expected one of the keys" in str(found.value)
    assert "did you mean" not in str(found.value)


@pytest.mark.parametrize(
    ("refuse", "near"),
    [
        (lambda: override(SimulationConfig().stage, {"presett": 1}, "stage"), "preset"),
        (
            lambda: override(
                SimulationConfig().environment,
                {"haze": {"visibility_m": 9, "colour_srgb": [1, 1, 1]}},
                "environment",
            ),
            "color_srgb",
        ),
        (lambda: asset_metadata({}, {"groups": {"ferns": {"hiden": True}}}), "hidden"),
        (lambda: SensorsModule(SimulationConfig().sensors).check({"camras": {}}), "cameras"),
        (
            lambda: SensorsModule(SimulationConfig().sensors).check_sample(
                {"cameras": {"camera": {"fx": 300.0}}}
            ),
            "fx_px",
        ),
        (
            lambda: SensorsModule(SimulationConfig().sensors).check(
                {"motion": {"kind": "hover", "lok": "down"}}
            ),
            "look",
        ),
    ],
)
def test_an_unknown_key_of_metadata_suggests_the_nearest(
    refuse: Callable[[], object], near: str
) -> None:
    with pytest.raises(InvalidInputError, match=r"^metadata") as found:
        refuse()
    assert found.value.expected.startswith("one of the keys ")
    assert f"(did you mean {near}?)" in found.value.expected


def test_a_fault_below_a_kind_has_the_line_of_its_own_key(tmp_path: Path) -> None:
    file = tmp_path / "motion.yaml"
    file.write_text("sensors:\n  motion:\n    kind: hover\n    look: up\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"motion\.yaml:4: sensors\.motion\.look: "):
        load_config(file)


def test_options_and_metadata_are_refused_in_the_same_words() -> None:
    qualities = "'geometry', 'draft', 'preview', 'standard', 'high' or 'final'"
    with pytest.raises(InvalidInputError) as found:
        adjust(SimulationConfig(), quality="x")
    assert str(found.value) == f"render.quality: received 'x', expected {qualities}"
    with pytest.raises(InvalidInputError) as found:
        override(SimulationConfig().render, {"quality": "x"}, "render")
    assert str(found.value) == f"metadata.render.quality: received 'x', expected {qualities}"
    with pytest.raises(InvalidInputError) as found:
        asset_metadata({}, {"count_factor": {"rock": "many"}})
    assert "expected" in str(found.value)
    assert not PYDANTIC.search(str(found.value))


def test_of_very_many_faults_the_first_are_told_and_all_are_counted() -> None:
    data = {f"key_{number}": 1 for number in range(5_000)}
    began_s = time.process_time()
    with pytest.raises(ConfigError) as caught:
        config_from_mapping(data)
    with pytest.raises(InvalidInputError, match=r"metadata\.stage\.key_0: received 1"):
        override(SimulationConfig().stage, data, "stage")
    assert time.process_time() - began_s < MOST_CPU_S
    *told, counted = str(caught.value).splitlines()
    assert [line.split(": ")[1] for line in told] == [f"key_{number}" for number in range(100)]
    assert counted == "config: 4900 more errors, 5000 in all"


LAYERS = """
stage: {preset: plane}
materials: {layers: [{texture: sand, label: sand, semantic_id: 1}]}
"""


def refused_line(text: str, folder: Path) -> str:
    """Return the only line of the error about a configuration."""
    path = folder / "world.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    (line,) = str(refused.value).splitlines()
    return line


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("density: [{kind: layer, label: []}]", "density.0.label: received [], expected text or"),
        ("density: [{kind: layer, label: [1]}]", "density.0.label.0: received 1, expected text"),
        ("density: [{kind: layer, label: {a: 1}}]", "density.0.label: received {'a': 1}, expected"),
    ],
)
def test_a_key_of_one_or_several_has_one_fault_at_its_own_path(
    section: str, message: str, tmp_path: Path
) -> None:
    """pydantic's names of alternatives, such as `label.str`, are no keys."""
    group = f"name: g, shape: boulder, label: b, semantic_id: 9, count: [1, 2], {section}"
    line = refused_line(f"{LAYERS}assets: {{groups: [{{{group}}}]}}\n", tmp_path)
    assert f" assets.groups.0.{message}" in line


@pytest.mark.parametrize(
    ("nodata", "message"),
    [
        ("[none]", "stage.dem.nodata.0: received 'none', expected a number"),
        ("[0, none]", "stage.dem.nodata.1: received 'none', expected a number"),
        ("{a: 1}", "stage.dem.nodata: received {'a': 1}, expected a number or"),
        ("nothing", "stage.dem.nodata: received 'nothing', expected a number or"),
    ],
)
def test_alternatives_of_a_value_are_one_fault(nodata: str, message: str, tmp_path: Path) -> None:
    line = refused_line(f"stage: {{dem: {{file: world.yaml, nodata: {nodata}}}}}\n", tmp_path)
    assert f" {message}" in line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "sensors: {cameras: [{modalities: [rgb, rgb]}]}",
            "sensors.cameras.0: modalities must differ (received modalities ['rgb', 'rgb'])",
        ),
        (
            "sensors: {cameras: [{}], lidars: [{min_range_m: 5, max_range_m: 2}]}",
            "max_range_m must be above min_range_m (received max_range_m 2, min_range_m 5)",
        ),
        (
            "sensors: {motion: {kind: spline, waypoints_m: [[0, 0, 1]]}}",
            "expected at least two waypoints",
        ),
    ],
)
def test_a_statement_about_a_section_has_the_values_that_it_names(
    text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "world.yaml"
    path.write_text(f"{text}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_config(path)
