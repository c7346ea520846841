"""Programs of the tools say what they are for, and refuse unknown arguments before they work."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from waiting import START_PATIENCE_S

from oaisys_core.system.python_programs import python_command
from tools.programs import ROOT, tool_environment


def tool_modules() -> list[str]:
    """The modules of `python -m tools.*`."""
    files = sorted((ROOT / "tools").rglob("*.py"))
    programs = [file for file in files if '__name__ == "__main__"' in file.read_text("utf-8")]
    names = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in programs]
    return [name.removesuffix(".__main__") for name in names]


def test_all_tools_are_found() -> None:
    assert {"tools.docs", "tools.wheels", "tools.licences"} < set(tool_modules())


@pytest.mark.parametrize(("argument", "code"), [("--help", 0), ("--nonsense", 2)])
@pytest.mark.parametrize("module", tool_modules())
def test_a_tool_answers_help_and_unknown_arguments_and_writes_nothing(
    module: str, argument: str, code: int, tmp_path: Path
) -> None:
    if module.endswith("mitsuba_light"):
        pytest.importorskip("mitsuba")
    ended = subprocess.run(
        python_command(module, argument),
        cwd=tmp_path,
        env=tool_environment(),
        capture_output=True,
        text=True,
        timeout=START_PATIENCE_S,
        check=False,
    )
    assert ended.returncode == code, ended.stderr
    said = ended.stderr if code else ended.stdout
    assert "usage" in said.lower()
    assert "Traceback" not in ended.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("argument", "code"), [("--help", 0), ("--nonsense", 2)])
def test_the_check_of_commit_messages_takes_a_file(
    argument: str, code: int, tmp_path: Path
) -> None:
    command = ["bash", str(ROOT / "tools/commit_subject.sh"), argument]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (code, "")
    assert ended.stderr.startswith("usage: ")
