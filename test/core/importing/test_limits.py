"""Values beyond our bounds are clamped, with the key of the original in the warning."""

import json
from pathlib import Path
from typing import Any

import pytest
from original_config import document

from oaisys_core.config import config_from_mapping
from oaisys_core.importing.importer import import_file

SKY = "ENVIRONMENT_EFFECTS_SETUP.ENVIRONMENT_EFFECTS.environmentEffectsParams"


def sky_of(data: dict[str, Any]) -> dict[str, Any]:
    effects = data["ENVIRONMENT_EFFECTS_SETUP"]["ENVIRONMENT_EFFECTS"]
    return next(e for e in effects if e["type"] == "EnvLightBlenderSky")["environmentEffectsParams"]


@pytest.mark.parametrize(
    ("key", "value", "field", "expected"),
    [
        ("DustDensity", [10.0, 20.0], "dust", [10.0, 10.0]),
        ("AirDensity", [-1.0, 12.0], "air", [0.0, 10.0]),
        ("SunAltitude", [100.0, 90000.0], "altitude_m", [100.0, 60000.0]),
        ("SunElevation", [20.0, 120.0], "sun_elevation_deg", [20.0, 90.0]),
    ],
)
def test_a_value_beyond_blenders_range_is_clamped_and_named(
    key: str, value: list[float], field: str, expected: list[float], tmp_path: Path
) -> None:
    data = document()
    sky_of(data)[key] = value
    file = tmp_path / "original.json"
    file.write_text(json.dumps(data))
    found = import_file(file)
    assert found.config["environment"][field] == expected
    config_from_mapping(found.config)
    told = [text for text in found.warnings if f"{SKY}.{key}" in text]
    assert len(told) == 1
    assert str(value) in told[0]


def test_counts_below_one_are_clamped(tmp_path: Path) -> None:
    data = document()
    data["SIMULATION_SETUP"]["numBatches"] = 0
    file = tmp_path / "original.json"
    file.write_text(json.dumps(data))
    found = import_file(file)
    assert found.config["output"]["batches"] == 1
    assert any("SIMULATION_SETUP.numBatches: 0 becomes 1" in text for text in found.warnings)
