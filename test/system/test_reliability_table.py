"""Every promise of docs/reliability.md names tests, and these exist."""

from __future__ import annotations

import ast
import re

import pytest
from repository import REPOSITORY

TABLE = REPOSITORY / "docs" / "reliability.md"
ROWS = 42
"""Rows that there must be at least."""
LONG_ROWS = {21, 24, 41}
"""What they promise shows over many samples or worlds only, in `make test-full`."""

NAMED = re.compile(r"`(test/[\w/]+\.py)::(\w+)`")


def named_tests() -> dict[int, list[tuple[str, str]]]:
    """Return file and name of the tests of each row."""
    rows = {}
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if found := re.match(r"\| (\d+) \|", line):
            rows[int(found[1])] = NAMED.findall(line)
    return rows


def test_every_row_names_tests() -> None:
    rows = named_tests()
    numbers = re.findall(r"^\| (\d+) \|", TABLE.read_text(encoding="utf-8"), re.MULTILINE)
    assert numbers == [str(number) for number in range(1, len(numbers) + 1)]
    assert len(rows) >= ROWS
    assert all(rows.values())


def functions_of(file: str) -> dict[str, ast.FunctionDef]:
    tree = ast.parse((REPOSITORY / file).read_text(encoding="utf-8"))
    return {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("row", named_tests())
def test_the_tests_of_a_row_exist(row: int) -> None:
    for file, name in named_tests()[row]:
        assert name in functions_of(file), f"{file} has no {name}"


@pytest.mark.parametrize("row", sorted(named_tests().keys() - LONG_ROWS))
def test_a_test_of_a_row_runs_in_make_test(row: int) -> None:
    tests = [functions_of(file)[name] for file, name in named_tests()[row]]
    marks = [[ast.unparse(mark) for mark in test.decorator_list] for test in tests]
    assert not all({"pytest.mark.long", "pytest.mark.soak"} & {*each} for each in marks)
    assert not [file for file, _ in named_tests()[row] if file.startswith("test/bench/")]
