"""The way of a view in docs/architecture.md, against the imports of the modules that it names."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from repository import REPOSITORY

PAGE = REPOSITORY / "docs" / "architecture.md"
ROW = re.compile(r"\| `(oaisys_[\w.]+)` \|")


def tables() -> list[list[str]]:
    """Return the modules of each table of the page, in their order."""
    found: list[list[str]] = []
    inside = False
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        row = ROW.match(line)
        if line.startswith("| module |"):
            found.append([])
            inside = True
        elif row and inside:
            found[-1].append(row[1])
        elif not line.startswith("|"):
            inside = False
    return found


def source_of(module: str) -> Path:
    path = REPOSITORY.joinpath(module.split(".")[0], *module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def imported_by(module: str) -> set[str]:
    """Return what a module imports, directly or from a package that imports it in turn."""
    names = named_by(module)
    packages = {name for name in names if source_of(name).name == "__init__.py"}
    return names.union(*map(named_by, packages))


def named_by(module: str) -> set[str]:
    """Return every name that a module imports, absolute; ``from a import b`` gives a and a.b."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source_of(module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def test_the_page_has_a_table_for_each_process() -> None:
    assert len(tables()) == 6
    assert all(len(modules) >= 2 for modules in tables())


@pytest.mark.parametrize("modules", tables(), ids=lambda modules: modules[0])
def test_the_modules_exist(modules: list[str]) -> None:
    assert [name for name in modules if not source_of(name).is_file()] == []


@pytest.mark.parametrize("modules", tables(), ids=lambda modules: modules[0])
def test_each_module_is_imported_by_one_above_it(modules: list[str]) -> None:
    reached = imported_by(modules[0])
    for module in modules[1:]:
        assert module in reached, f"no module above {module} imports it"
        reached |= imported_by(module)


def test_a_view_is_learned_from_at_most_six_files_that_exist() -> None:
    section = (
        PAGE.read_text(encoding="utf-8").split("## How a view is rendered")[1].split("\n## ")[0]
    )
    files = re.findall(r"^\d\. `([\w/]+\.py)`", section, re.MULTILINE)
    assert 0 < len(files) <= 6
    core = REPOSITORY / "oaisys_core" / "oaisys_core"
    every = re.findall(r"`([\w/]+\.py)`", section)
    assert [file for file in every if not (core / file).is_file()] == []


@pytest.mark.parametrize(
    "what",
    [
        "a kind of image (modality) is added",
        "a format of data sets is added",
        "a private symbol of Blender is used",
    ],
)
def test_what_is_looked_for_is_in_at_most_three_modules(what: str) -> None:
    (row,) = re.findall(
        rf"^\| {re.escape(what)} \| (.+) \|$", PAGE.read_text("utf-8"), re.MULTILINE
    )
    assert 0 < len(re.findall(r"`oaisys_[\w.]+(?:/setup\.cfg)?`", row)) <= 3
