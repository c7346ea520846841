"""`oaisys doctor`: what it finds, and that it says what to do where something is missing."""

from __future__ import annotations

import json
import os
import socket
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from commands import oaisys

from oaisys_core.errors import InvalidInputError
from oaisys_core.system import machine_checks
from oaisys_core.system.machine_checks import Finding, examine_machine

FREE = "127.0.0.1:0"


@pytest.fixture
def without_blender(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the process that asks Blender for GPUs."""
    monkeypatch.setattr(machine_checks, "_gpu", lambda: Finding("GPU", "optional", "not asked"))


def finding(name: str, address: str = FREE) -> Finding:
    return next(each for each in examine_machine(address) if each.name == name)


@pytest.mark.long
@pytest.mark.blender
def test_the_program_prints_findings_for_programs() -> None:
    result = oaisys("doctor", "--json", "--address", FREE)
    assert result.returncode == 0, result.stderr
    found = {each["name"]: each for each in json.loads(result.stdout)}
    assert found["numpy"]["state"] == "ok"
    assert found["numpy"]["found"].startswith(version("numpy"))
    assert found["Blender (bpy)"]["found"] == version("bpy")
    assert "did not say" not in found["GPU"]["found"]


@pytest.mark.usefixtures("without_blender")
def test_a_missing_package_is_named_with_the_line_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def absent(name: str) -> str:
        if name == "open3d":
            raise PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(machine_checks, "version", absent)
    found = finding("open3d")
    assert found.state == "missing"
    assert found.remedy == "pip install 'oaisys_core[simulator]'"


@pytest.mark.usefixtures("without_blender")
def test_a_port_in_use_and_a_free_one() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        assert finding("port", address).state == "optional"
        assert "any free port" in finding("port", address).remedy
    assert finding("port").state == "ok"


@pytest.mark.usefixtures("without_blender")
@pytest.mark.parametrize(
    "address", ["", "50051", "here:", "here:70000", "here:-1", "here:²", "here:٣", "here:1\n"]
)
def test_an_address_without_a_port_is_refused(address: str) -> None:
    with pytest.raises(InvalidInputError, match="HOST:PORT"):
        examine_machine(address)


def test_no_shared_memory_is_said_with_what_works_instead(tmp_path: Path) -> None:
    found = machine_checks._shared_memory(tmp_path / "none")
    assert found.state == "optional"
    assert "--shm-size" in found.remedy


def test_a_blender_that_crashes_does_not_end_the_doctor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_checks, "find_spec", lambda _: object())
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert "did not say: CalledProcessError" in machine_checks._gpu().found


def test_a_temporary_folder_that_takes_no_files_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "none"))
    found = machine_checks._temporary_folder()
    assert found.state == "optional"
    assert f"{tmp_path / 'none'}' takes none" in found.found
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert machine_checks._temporary_folder() == Finding("temporary files", "ok", f"in {tmp_path}")

    def nowhere() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", nowhere)
    assert machine_checks._temporary_folder().state == "missing"


@pytest.mark.usefixtures("without_blender")
def test_what_cannot_be_examined_does_not_end_the_doctor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()

    def refuse(_name: str) -> int:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(os, "sysconf", refuse)
    monkeypatch.setenv("ROS_DOMAIN_ID", "one")
    found = {each.name: each for each in examine_machine(f"{'a' * 80}.example:1")}
    assert found["disk"].found == "the current folder has been removed"
    assert found["memory"].found.startswith("cannot be examined here: OSError: ")
    assert "cannot be used: " in found["port"].found
    assert "ROS_DOMAIN_ID is 'one', expected a number from 0 to 232" in found["ROS 2"].found
    monkeypatch.chdir(tmp_path)


def test_a_python_that_cannot_be_started_does_not_end_the_doctor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(machine_checks, "find_spec", lambda _: object())
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    assert "did not say: FileNotFoundError" in machine_checks._gpu().found
