"""Functions are named by verbs and nouns: a participle says neither what acts nor what returns."""

from __future__ import annotations

import ast
from collections.abc import Iterator

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


def test_no_public_function_begins_with_a_participle() -> None:
    found = []
    for package in PACKAGES:
        for file in sorted((REPOSITORY / package).rglob("*.py")):
            where = file.relative_to(REPOSITORY).as_posix()
            if "/pb/" in where or "/build/" in where:
                continue
            tree = ast.parse(file.read_text(encoding="utf-8"))
            for place, name in public_functions(tree, where):
                if name.islower() and is_participle(name.split("_")[0]) and name not in GIVEN:
                    found.append(f"{place} {name}")

    assert not found, "imperatives for what acts, nouns for what is returned: " + "; ".join(found)
