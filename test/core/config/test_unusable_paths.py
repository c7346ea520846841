"""Paths in configurations that lead nowhere, and values where a list is expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError
from oaisys_core.files.path_fields import AssetRoots


def refusal(file: str, base: Path) -> str:
    with pytest.raises(ConfigError) as raised:
        config_from_mapping({"stage": {"mesh": {"file": file}}}, base)
    return str(raised.value)


def test_paths_that_lead_nowhere_are_refused_in_a_sentence(tmp_path: Path) -> None:
    """Links in a circle and the home of nobody were tracebacks; long names were told whole."""
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    assert "go in a circle" in refusal("a", tmp_path)
    assert "go in a circle" in refusal("a/x", tmp_path)
    assert "stage.mesh.file" in refusal("~no_such_user/x", tmp_path)
    assert len(refusal("x" * 5000, tmp_path)) < 400


def test_texts_that_look_like_paths_do_not_end_a_server(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("a")
    config = config_from_mapping({"environment": {"sky_label": f"{tmp_path}/a"}})
    assert AssetRoots.of([tmp_path], config).folders == (tmp_path.resolve(),)


@pytest.mark.parametrize("value", [-1, 1e300, True, {"a": 1}, "x"])
def test_elevations_that_are_no_list_are_refused(value: object) -> None:
    scan = {"kind": "rotating", "elevations_deg": value}
    with pytest.raises(ConfigError, match="elevations_deg"):
        config_from_mapping({"sensors": {"lidars": [{"scan": scan}]}})


def test_empty_texts_are_no_paths(tmp_path: Path) -> None:
    """They were the folder of the configuration, or the current one."""
    for world, field in (
        ({"environment": {"hdri": {"folder": ""}}}, "environment.hdri.folder"),
        ({"stage": {"mesh": {"file": ""}}}, "stage.mesh.file"),
        ({"stage": {"store": ""}}, "stage.store"),
        ({"output": {"folder": ""}}, "output.folder"),
    ):
        with pytest.raises(ConfigError, match=f"{field}: received ''"):
            config_from_mapping(world, tmp_path)
