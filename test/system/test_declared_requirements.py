"""What the core imports is what its wheel asks for: an empty environment then has all of it."""

from __future__ import annotations

import ast
import configparser
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from repository import REPOSITORY

FOLDER = REPOSITORY / "oaisys_core"
BROUGHT = {
    "affine": "rasterio",
    "cycles": "bpy",
    "mathutils": "bpy",
    "pxr": "bpy",
    "pydantic_core": "pydantic",
}
"""Modules that always come with a declared package."""

OPTIONAL = {"backports", "compression"}
"""Zstandard, for images of foreign data sets: without it the error says what to install."""


def imported_modules() -> Iterator[tuple[str, str]]:
    """Yield each import of another package: where it is, and of what."""
    for file in sorted((FOLDER / "oaisys_core").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level and node.module:
                names = [node.module]
            for name in {name.partition(".")[0] for name in names}:
                if name not in {*sys.stdlib_module_names, *OPTIONAL, "oaisys_core"}:
                    yield file.relative_to(FOLDER).as_posix(), name


def declared() -> set[str]:
    """The packages that setup.cfg names, in all extras but that of the tests."""
    config = configparser.ConfigParser()
    config.read(FOLDER / "setup.cfg")
    texts = [config["options"]["install_requires"]]
    extras = config["options.extras_require"]
    texts += [text for extra, text in extras.items() if extra != "test"]
    lines = [line for text in texts for line in text.splitlines() if line and line[0] != "#"]
    return {canonicalize_name(Requirement(line).name) for line in lines}


def test_all_that_is_imported_is_declared() -> None:
    found, known = packages_distributions(), declared()
    missing = []
    for file, module in imported_modules():
        packages = [BROUGHT.get(module, module), *found.get(module, [])]
        if not known & {canonicalize_name(package) for package in packages}:
            missing.append(f"{file} imports {module}")
    assert not missing
