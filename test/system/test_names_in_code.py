"""Functions are named by verbs and nouns, and a name stands for one class."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import pytest
from repository import REPOSITORY

PACKAGES = (
    *("oaisys_core", "oaisys_dataset", "oaisys_grpc", "oaisys_gym"),
    *("oaisys_mapping", "oaisys_ros_bridge"),
    "tools",
)
IRREGULAR = {
    *("begun", "broken", "built", "chosen", "done", "drawn", "driven", "fallen", "found", "frozen"),
    *("given", "grown", "held", "hidden", "kept", "known", "left", "lent", "lit", "lost", "made"),
    *("seen", "sent", "shown", "sold", "spent", "stuck", "taken", "told", "torn", "written"),
}
NO_PARTICIPLES = {
    "embed",
    "exceed",
    "feed",
    "need",
    "proceed",
    "red",
    "reed",
    "seed",
    "speed",
    "succeed",
}
GIVEN = {
    "namespaced": "trimesh calls it",
    "rippled_sand": "a texture's name in configurations",
}


class Names(NamedTuple):
    """Names with their places: of public functions, and of classes of modules."""

    functions: list[tuple[str, str]]
    classes: list[tuple[str, str]]


def public_functions(node: ast.AST, where: str) -> Iterator[tuple[str, str]]:
    """Yield place and name of the public functions of modules and classes."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            if not child.name.startswith("_"):
                yield f"{where}:{child.lineno}", child.name
        elif isinstance(child, ast.ClassDef | ast.If | ast.Try):
            yield from public_functions(child, where)


def is_participle(word: str) -> bool:
    """Return whether a word is the past participle of a verb."""
    return word in IRREGULAR or (word.endswith("ed") and word not in NO_PARTICIPLES)


def modules() -> Iterator[tuple[str, ast.Module]]:
    """Yield path and syntax tree of the modules of product and tools: one is kept at a time."""
    for package in PACKAGES:
        for file in sorted((REPOSITORY / package).rglob("*.py")):
            where = file.relative_to(REPOSITORY).as_posix()
            if "/pb/" not in where and "/build/" not in where:
                yield where, ast.parse(file.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def names() -> Names:
    """The names of all modules."""
    found = Names([], [])
    for where, tree in modules():
        found.functions.extend(public_functions(tree, where))
        classes = (node.name for node in tree.body if isinstance(node, ast.ClassDef))
        found.classes.extend((where, name) for name in classes)
    return found


def test_no_public_function_begins_with_a_participle(names: Names) -> None:
    found = [
        f"{place} {name}"
        for place, name in names.functions
        if name.islower() and is_participle(name.split("_")[0]) and name not in GIVEN
    ]
    assert not found, "imperatives for what acts, nouns for what is returned: " + "; ".join(found)


def test_no_two_classes_share_a_name(names: Names) -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for where, name in names.classes:
        places[name].append(where)
    shared = {name: found for name, found in places.items() if len(found) > 1}
    assert not shared, shared
