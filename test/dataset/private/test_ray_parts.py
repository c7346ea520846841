"""Ray without its private arguments and methods: it starts all the same."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from oaisys_dataset.private import ray_job_config, ray_messages, ray_options
from oaisys_dataset.rendering.ray_session import ray_session
from oaisys_dataset.rendering.ray_settings import RaySettings


@pytest.mark.long
def test_without_private_arguments_the_folder_is_told_by_a_variable(
    monkeypatch: pytest.MonkeyPatch, fallback_lines: Callable[[], list[str]]
) -> None:
    monkeypatch.setattr(ray_options, "FOLDER", "_gone")
    monkeypatch.setattr(ray_options, "MEMORY", "_gone_too")
    parent = Path(tempfile.mkdtemp(prefix="t", dir="/tmp"))
    monkeypatch.setattr(tempfile, "tempdir", str(parent))
    try:
        with ray_session(RaySettings(workers=1, memory_gb=0.1)) as session:
            assert session.folder is not None
            assert list(session.folder.rglob("session_2*/sockets/plasma_store"))
        assert not session.folder.exists()
    finally:
        parent.rmdir()
    (line,) = fallback_lines()
    assert "Ray's folder and memory cannot be used (Unknown keyword argument" in line
    assert "RAY_TMPDIR" not in os.environ


def test_without_the_private_method_a_job_has_rays_own_configuration(
    monkeypatch: pytest.MonkeyPatch, fallback_lines: Callable[[], list[str]]
) -> None:
    ray = pytest.importorskip("ray", exc_type=ModuleNotFoundError)
    assert isinstance(ray_job_config.safe_path_config(ray), ray.job_config.JobConfig)
    assert fallback_lines() == []
    monkeypatch.setattr(ray_job_config, "ASKED", "_gone")
    assert [ray_job_config.safe_path_config(ray) for _ in range(2)] == [None, None]
    (line,) = fallback_lines()
    assert "Ray's path of Python cannot be used (JobConfig has no _gone)" in line


@pytest.mark.parametrize("is_there", [True, False])
def test_what_daemons_report_goes_to_the_descriptor_of_standard_error(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], is_there: bool
) -> None:
    from ray._private import worker

    if not is_there:
        monkeypatch.setattr(ray_messages, "FUNCTION", "gone")
    with ray_messages.write_reports_like_a_library():
        worker.print_to_stdstream(
            {"lines": ["a daemon died"], "pid": "raylet", "is_err": False}, ignore_prefix=False
        )
    written = capfd.readouterr()
    assert ("a daemon died" in written.out) == (not is_there)
    assert ("a daemon died" in written.err) == is_there
