"""uv and pip: what uv is told of pip's settings, and what happens where uv fails."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tools.setup.environment import Environment
from tools.setup.errors import SetupError
from tools.setup.installers import (
    Installer,
    UvCache,
    pip_progress,
    uv_cache,
    uv_progress,
    uv_settings,
)
from tools.setup.packages import install_pinned
from tools.setup.programs import Display, Programs
from tools.setup.relocation import relocate

PREFIX = Path(sys.prefix)

PIP_CONFIG = """\
:env:.cert='/etc/own.crt'
:env:.find-links='/wheels /more'
global.cert='/etc/usual.crt'
global.extra-index-url='https://a.example/simple\\nhttps://b.example/simple'
global.index-url='https://general.example/simple'
global.timeout='10'
install.index-url='https://install.example/simple'
install.trusted-host='a.example'
"""


def test_uv_is_told_what_pip_is_configured_with() -> None:
    settings = uv_settings(PIP_CONFIG)
    assert settings.options == (
        "--index-url=https://install.example/simple",
        "--extra-index-url=https://a.example/simple",
        "--extra-index-url=https://b.example/simple",
        "--find-links=/wheels",
        "--find-links=/more",
        "--allow-insecure-host=a.example",
    )
    assert settings.variables["SSL_CERT_FILE"] == "/etc/own.crt"
    assert uv_settings("").options == ()
    assert "SSL_CERT_FILE" not in uv_settings("").variables
    assert uv_settings("install.no-index='true'\n").options == ("--no-index",)


def test_pip_prints_its_configuration_as_it_is_read_here(tmp_path: Path) -> None:
    file = tmp_path / "pip.conf"
    file.write_text("[global]\nextra-index-url =\n    file:///a\n    file:///b\n")
    variables = {k: v for k, v in os.environ.items() if not k.startswith("PIP_")}
    variables |= {"PIP_CONFIG_FILE": str(file), "PIP_CERT": "/own.crt", "HOME": str(tmp_path)}
    result = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        env=variables,
        capture_output=True,
        text=True,
        check=True,
    )
    settings = uv_settings(result.stdout)
    indices = [option for option in settings.options if option.startswith("--extra-index-url")]
    assert indices == ["--extra-index-url=file:///a", "--extra-index-url=file:///b"]
    assert settings.variables["SSL_CERT_FILE"] == "/own.crt"


def test_a_cache_that_cannot_be_written_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("UV_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "uv"
    assert uv_cache(tmp_path / "no" / "venv", 1e6) == UvCache(folder, linked=True)
    assert list(folder.iterdir()) == []
    assert {path.name for path in tmp_path.iterdir()} == {"cache"}
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert uv_cache(tmp_path, 1e6) is None


def test_a_cache_whose_files_must_be_copied_needs_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError("invalid cross-device link")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    monkeypatch.setenv("UV_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr("tools.setup.installers.CACHE_GB", 0.0)
    assert uv_cache(tmp_path / "venv", 0.0) == UvCache(tmp_path / "cache", linked=False)
    assert uv_cache(tmp_path / "venv", 1e6) is None


def test_relocation_rewrites_text_and_is_idempotent(tmp_path: Path) -> None:
    share = tmp_path / "share"
    share.mkdir()
    cmake = share / "export.cmake"
    cmake.write_text(
        "/opt/python/cp311-cp311/include/python3.11;"
        "/opt/python/cp311-cp311/lib/python3.11/site-packages/numpy/_core/include;"
        "/opt/python/cp311-cp311\n"
    )
    binary = share / "data.bin"
    binary.write_bytes(b"\0/opt/python/cp311-cp311\0")

    assert relocate(tmp_path, Path("/usr/include/python3.11"), Path("/np/include")) == 1
    expected = f"/usr/include/python3.11;/np/include;{tmp_path}\n"
    assert cmake.read_text() == expected
    assert binary.read_bytes() == b"\0/opt/python/cp311-cp311\0"
    assert relocate(tmp_path, Path("/elsewhere"), Path("/elsewhere")) == 0
    assert cmake.read_text() == expected


def test_relocation_leaves_the_linked_file_of_the_cache_as_it_is(tmp_path: Path) -> None:
    cached = tmp_path / "cached.sh"
    cached.write_text("/opt/python/cp311-cp311\n")
    cached.chmod(0o755)
    installed = tmp_path / "venv" / "share" / "installed.sh"
    installed.parent.mkdir(parents=True)
    installed.hardlink_to(cached)

    assert relocate(tmp_path / "venv", Path("/include"), Path("/include")) == 1
    assert cached.read_text() == "/opt/python/cp311-cp311\n"
    assert installed.read_text() == f"{tmp_path / 'venv'}\n"
    assert installed.stat().st_mode & 0o777 == 0o755
    assert [file.name for file in installed.parent.iterdir()] == ["installed.sh"]


def program(file: Path, script: str) -> None:
    """Make a program that notes its arguments before it does ``script``."""
    file.parent.mkdir(parents=True, exist_ok=True)
    calls = shlex.quote(str(file.with_name("calls")))
    file.write_text(f'#!/bin/sh\necho "{file.name} $*" >> {calls}\n{script}\n')
    file.chmod(0o755)


PINNED = "a-package==1.0\nuv==2.0\n"


@pytest.mark.parametrize(
    ("uv", "pip", "told"),
    [
        ("echo no network; exit 2", "exit 0", "uv failed"),
        (None, "exit 0", "uv failed"),
        ("exit 0", 'case "$*" in *uv==*) echo none; exit 1;; esac', "pip cannot install uv"),
    ],
    ids=["fails", "is missing", "is not on the index"],
)
def test_pip_installs_where_uv_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], uv: str | None, pip: str, told: str
) -> None:
    environment = Environment(tmp_path)
    program(environment.python, pip)
    if uv is not None:
        program(environment.root / "bin" / "uv", uv)
    requirements = tmp_path / "pinned.txt"
    requirements.write_text(PINNED)
    renewed: list[bool] = []
    installer = Installer(environment, Programs(Display()), cache=None)
    install_pinned(installer, requirements, lambda: renewed.append(True))

    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert told in lines[0]
    assert str(installer.uv_log) in lines[0]
    assert installer.uv_log.read_text() != ""
    assert renewed == [True]
    last = (tmp_path / "bin" / "calls").read_text().splitlines()[-1].split()
    assert last[:5] == ["python", "-P", "-m", "pip", "install"]
    # An index without uv must not keep pip from the rest.
    assert Path(last[-1]).read_text() == "a-package==1.0\n"


def test_pip_is_not_asked_where_uv_installs(tmp_path: Path) -> None:
    environment = Environment(tmp_path)
    program(environment.python, """case "$*" in *config*) echo "global.index-url='u'";; esac""")
    program(environment.root / "bin" / "uv", "exit 0")
    requirements = tmp_path / "pinned.txt"
    requirements.write_text(PINNED)
    cache = UvCache(tmp_path / "cache", linked=True)
    installer = Installer(environment, Programs(Display()), cache)
    install_pinned(installer, requirements, lambda: pytest.fail("emptied"))

    calls = (tmp_path / "bin" / "calls").read_text().splitlines()
    assert [call.split()[0] for call in calls] == ["python", "python", "uv"]
    assert calls[0].endswith(" uv==2.0")
    assert "--no-deps" in calls[2].split()
    assert "--index-url=u" in calls[2].split()
    assert f"--cache-dir {cache.folder}" in calls[2]
    assert f"--requirement {requirements}" in calls[2]


def test_a_failure_of_both_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    environment = Environment(tmp_path)
    program(environment.python, "echo ERROR: no such package; exit 1")
    requirements = tmp_path / "pinned.txt"
    requirements.write_text(PINNED)
    installer = Installer(environment, Programs(Display()), cache=None)
    with pytest.raises(SetupError, match=r"pip failed.*pip\.log"):
        install_pinned(installer, requirements, lambda: None)
    assert "ERROR: no such package" in capsys.readouterr().err


def test_progress_counts_what_is_collected_and_installed(tmp_path: Path) -> None:
    for name in ("a-1.dist-info", "b-1.dist-info", "b"):
        (tmp_path / name).mkdir()
    said = "Collecting a\nRequirement already satisfied: b\n"
    assert pip_progress(said, 4, tmp_path).text == "2 of 4 packages collected"
    assert pip_progress(said, 4, tmp_path).share == 0.25
    said += "Installing collected packages: a, b\n"
    assert pip_progress(said, 4, tmp_path).text == "2 of 4 packages installed"
    assert pip_progress(said, 4, tmp_path).share == 0.75


def test_progress_of_uv_is_what_it_has_downloaded_and_installed(tmp_path: Path) -> None:
    (tmp_path / "a-1.dist-info").mkdir()
    said = "Resolved 4 packages in 1s\n"
    assert uv_progress(said, 4, tmp_path).share == 0.0
    said += "Downloading a (0.5GiB)\nDownloading b (1.0MiB)\nDownloading c (512.0KiB)\n"
    said += " Downloaded b\n Downloaded tiny\n"
    assert uv_progress(said, 4, tmp_path).text == "1 of 538 MB downloaded"
    said += " Downloaded a\n Downloaded c\n"
    assert uv_progress(said, 4, tmp_path).share == 0.5
    said += "Prepared 4 packages in 9s\n"
    assert uv_progress(said, 4, tmp_path).text == "1 of 4 packages installed"


def test_the_environment_has_uv_and_a_pip_that_works() -> None:
    for command in ([PREFIX / "bin" / "uv"], [sys.executable, "-m", "pip"]):
        result = subprocess.run([*command, "--version"], capture_output=True, check=False)
        assert result.returncode == 0
