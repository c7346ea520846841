"""Programs of the tools say what they are for, and refuse unknown arguments before they work."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from tool_arguments import ANSWERS, check_answer

from tools.programs import ROOT


@pytest.mark.parametrize(("argument", "code"), ANSWERS)
@pytest.mark.parametrize("module", ["tools.docs", "tools.licences", "tools.wheels"])
def test_a_tool_that_writes_answers_help_and_unknown_arguments_and_writes_nothing(
    module: str, argument: str, code: int, tmp_path: Path
) -> None:
    check_answer(module, argument, code, tmp_path)


@pytest.mark.parametrize(("argument", "code"), ANSWERS)
def test_the_check_of_commit_messages_takes_a_file(
    argument: str, code: int, tmp_path: Path
) -> None:
    command = ["bash", str(ROOT / "tools/commit_subject.sh"), argument]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (code, "")
    assert ended.stderr.startswith("usage: ")
