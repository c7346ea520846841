"""What `pre-commit` runs before a commit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
import yaml
from repository import REPOSITORY


def run_subject_check(folder: Path, message: str) -> subprocess.CompletedProcess[str]:
    file = folder / "message"
    file.write_text(message, encoding="utf-8")
    command = [REPOSITORY / "tools" / "commit_subject.sh", file]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "message", ["s" * 72, "A subject\n\nA body.\n", "# a comment\nA subject\n# another\n"]
)
def test_a_subject_of_72_characters_and_a_body_are_accepted(tmp_path: Path, message: str) -> None:
    assert run_subject_check(tmp_path, message).returncode == 0


@pytest.mark.parametrize(
    ("message", "fault"),
    [("s" * 73, "73 characters"), ("A subject\nwithout an empty line", "empty line")],
)
def test_a_long_subject_is_refused(tmp_path: Path, message: str, fault: str) -> None:
    refused = run_subject_check(tmp_path, message)
    assert refused.returncode == 1
    assert fault in refused.stderr


def test_the_hooks_need_no_network() -> None:
    text = (REPOSITORY / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    repositories = yaml.safe_load(text)["repos"]
    assert [repository["repo"] for repository in repositories] == ["local"]
    hooks = [hook for repository in repositories for hook in repository["hooks"]]
    assert {hook["language"] for hook in hooks} == {"system"}
    for hook in hooks:
        assert (REPOSITORY / hook["entry"].split()[0]).is_file()


def test_the_settings_are_what_pre_commit_takes() -> None:
    command = ["pre-commit", "validate-config", str(REPOSITORY / ".pre-commit-config.yaml")]
    subprocess.run(command, check=True, capture_output=True)
