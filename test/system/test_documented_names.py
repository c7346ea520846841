"""What README, docs and examples name exists: links, modules, imports, commands."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from repository import REPOSITORY

PAGES = [
    *sorted(REPOSITORY.glob("*.md")),
    *sorted(REPOSITORY.glob("oaisys_*/README.md")),
    *sorted((REPOSITORY / "docs").rglob("*.md")),
    *sorted((REPOSITORY / "examples").rglob("*.md")),
]
NAMES = [path.relative_to(REPOSITORY).as_posix() for path in PAGES]
README_LINES, README_COLUMNS = 110, 100

LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"```\w*\n.*?```", re.DOTALL)
PYTHON = re.compile(r"```python\n(.*?)```", re.DOTALL)
DOTTED = re.compile(r"`(oaisys_[a-z_]+(?:\.\w+)+)(?:\(.*?\))?`")
COMMAND = re.compile(r"\boaisys ([a-z]+)(?: ([a-z]+))?")
PACKAGES = {
    *("oaisys_core", "oaisys_dataset", "oaisys_grpc", "oaisys_gym"),
    *("oaisys_mapping", "oaisys_ros_bridge"),
}


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives to a page's headings."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings
    }


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
        if link.startswith(("http://", "https://")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def has_name(module: str, name: str) -> bool:
    """Whether a module's source defines or imports a name, or it is a module inside of it."""
    path = REPOSITORY.joinpath(module.split(".")[0], *module.split("."))
    if (path / f"{name}.py").is_file() or (path / name).is_dir():
        return True
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return source.is_file() and name in set(defined(ast.parse(source.read_text("utf-8")).body))


def defined(body: list[ast.stmt]) -> Iterator[str]:
    """Yield the names that statements at the top of a module define or import."""
    for node in body:
        if isinstance(node, ast.If):
            yield from defined(node.body)
        elif isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.ImportFrom | ast.Import):
            yield from (alias.asname or alias.name for alias in node.names)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (target.id for target in targets if isinstance(target, ast.Name))


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_modules_and_their_names_exist(page: Path) -> None:
    for dotted in set(DOTTED.findall(page.read_text(encoding="utf-8"))):
        parts = dotted.split(".")
        if parts[0] not in PACKAGES:
            continue
        depth = next((i for i, part in enumerate(parts) if part[0].isupper()), len(parts) - 1)
        assert has_name(".".join(parts[:depth]), parts[depth]), dotted


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_imports_that_are_shown_work(page: Path) -> None:
    for code in PYTHON.findall(page.read_text(encoding="utf-8")):
        for node in ast.walk(ast.parse(code)):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            if isinstance(node, ast.ImportFrom) and module and module.split(".")[0] in PACKAGES:
                assert [a.name for a in node.names if not has_name(module, a.name)] == [], module


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_that_are_shown_are_installed(page: Path) -> None:
    installed = set(entry_points(group="oaisys.commands").names)
    text = page.read_text(encoding="utf-8")
    shown = {
        match[1]
        for quoted in re.findall(r"`[^`\n]+`|^ *oaisys .*$", text, re.MULTILINE)
        for match in COMMAND.finditer(quoted)
    }
    assert shown <= installed


def test_every_command_is_documented() -> None:
    page = (REPOSITORY / "docs" / "commands.md").read_text(encoding="utf-8")
    for name in entry_points(group="oaisys.commands").names:
        assert f"`oaisys {name}" in page, name


def test_the_readme_stays_short() -> None:
    lines = (REPOSITORY / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= README_LINES
    assert [line for line in lines if len(line) > README_COLUMNS] == []
