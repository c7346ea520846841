"""``~`` at the begin of a path is a home folder behind every door, as in a shell."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import oaisys_here

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.folders import user_path
from oaisys_grpc.tls import client_tls
from oaisys_ros_bridge.parameters.mapper import MAPPER, tsdf_config
from oaisys_ros_bridge.parameters.node_settings import node_settings

STRANGER = "~nosuchuser/x"
REFUSED = rf"received '{STRANGER}', expected .* not 'nosuchuser'"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "home"
    folder.mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("HOME", str(folder))
    return folder


def test_a_path_is_expanded_at_its_begin_alone(home: Path) -> None:
    assert user_path("~/a/~", "out") == home / "a" / "~"
    assert user_path("~", "out") == home
    assert user_path("a~b/c", "out") == Path("a~b/c")


def store_folder(path: str) -> Path | None:
    table = {row.name: row.default for row in MAPPER}
    return tsdf_config({**table, "store_folder": path}).store_folder


def certificate(path: str) -> Path | None:
    tls = client_tls(path, None, None)
    assert tls is not None
    return tls.ca


def parameter_file(path: str) -> Path | None:
    return node_settings(path, "", use_sim_time=False).params_file


@pytest.mark.parametrize("door", [store_folder, certificate, parameter_file])
def test_parameters_and_options_know_homes(door: Callable[[str], Any], home: Path) -> None:
    (home / "x").write_text("{}")
    assert door("~/x") == home / "x"
    with pytest.raises(InvalidInputError, match=REFUSED):
        door(STRANGER)


def test_commands_know_homes(home: Path) -> None:
    """A shell leaves ``--out=~/x`` as it is: a folder called ``~`` was made."""
    (home / "world.yaml").write_text("backend: analytic\n")
    assert oaisys_here("config", "check", "~/world.yaml").returncode == 0
    shown = oaisys_here("config", "show", "--config=~/world.yaml")
    assert shown.returncode == 0, shown.stderr
    for command in (("config", "check", STRANGER), ("render", f"--out={STRANGER}")):
        refused = oaisys_here(*command)
        assert refused.returncode == 2
        assert "not 'nosuchuser'" in refused.stderr
    assert not list(Path().iterdir())
