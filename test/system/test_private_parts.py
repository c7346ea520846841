"""Private parts of other libraries: each in a module that says what is done without it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from repository import REPOSITORY

MODULES = sorted(
    path for path in REPOSITORY.glob("oaisys_*/oaisys_*/private/*.py") if path.stem != "__init__"
)
HEADINGS = ("Private part: ", "Tried with: ", "Public way without it: ", "Lost without it: ")
PAGE = REPOSITORY / "docs" / "architecture.md"


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(REPOSITORY).with_suffix("").parts[1:])


@pytest.mark.parametrize("path", MODULES, ids=dotted)
def test_each_says_what_is_done_without_it(path: Path) -> None:
    told = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    assert [each for each in HEADINGS if f"\n{each}" not in told] == []


def test_the_page_lists_each_with_its_test() -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Private parts of other libraries\n")[1]
    rows = [line for line in section.split("\n## ")[0].splitlines() if line.startswith("| ")]
    listed, test = {}, ""
    for row in rows[1:]:
        _, _, module, *_, given, _ = (cell.strip(" `") for cell in row.split("|"))
        test = test if given == "the same" else given
        listed[module] = test
    assert set(listed) == {dotted(path) for path in MODULES}
    assert [test for test in listed.values() if not (REPOSITORY / test).is_file()] == []


def test_libraries_of_others_are_called_by_ctypes_only_there() -> None:
    """The C library of the process itself is no part of another library."""
    for path in REPOSITORY.glob("oaisys_*/oaisys_*/**/*.py"):
        if path.parent.name != "private":
            text = path.read_text(encoding="utf-8")
            assert text.count("CDLL(") == text.count("CDLL(None"), path
