"""All programs of the tools say what they are for, and refuse unknown arguments."""

from __future__ import annotations

from pathlib import Path

import pytest
from tool_arguments import ANSWERS, check_answer

from tools.programs import ROOT


def tool_modules() -> list[str]:
    """The modules of `python -m tools.*`."""
    files = sorted((ROOT / "tools").rglob("*.py"))
    programs = [file for file in files if '__name__ == "__main__"' in file.read_text("utf-8")]
    names = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in programs]
    return [name.removesuffix(".__main__") for name in names]


def test_all_tools_are_found() -> None:
    assert {"tools.docs", "tools.wheels", "tools.licences"} < set(tool_modules())


@pytest.mark.parametrize(("argument", "code"), ANSWERS)
@pytest.mark.parametrize("module", tool_modules())
def test_a_tool_answers_help_and_unknown_arguments_and_writes_nothing(
    module: str, argument: str, code: int, tmp_path: Path
) -> None:
    if module.endswith("mitsuba_light"):
        pytest.importorskip("mitsuba", exc_type=ModuleNotFoundError)
    check_answer(module, argument, code, tmp_path)
