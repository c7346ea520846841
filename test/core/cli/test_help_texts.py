"""Each command's help ends with an example that the command itself understands."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from oaisys_core.cli.help_texts import EXAMPLES, GROUPS, OTHERS, group_names
from oaisys_core.cli.main import app


def root() -> Any:
    return typer.main.get_command(app)


def walk(command: Any, context: Any, path: str) -> Iterator[tuple[str, Any]]:
    yield path, command
    for name in command.list_commands(context) if hasattr(command, "list_commands") else ():
        part = command.get_command(context, name)
        yield from walk(part, type(context)(part, info_name=name, parent=context), f"{path} {name}")


@cache
def commands() -> dict[str, Any]:
    command = root()
    context = command.make_context("oaisys", [], resilient_parsing=True)
    return dict(walk(command, context, "oaisys"))


def parse(words: list[str]) -> str:
    """Return the full name of the command that a line names, after all its options are read."""
    command, path, rest = root(), "oaisys", words
    context = command.make_context("oaisys", list(rest))
    while True:
        rest = [*context._protected_args, *context.args]
        if not rest or not hasattr(command, "resolve_command"):
            return path
        name, command, rest = command.resolve_command(context, rest)
        path = f"{path} {name}"
        context = command.make_context(name, rest, parent=context)


def test_every_command_has_an_example_and_no_example_is_without_its_command() -> None:
    assert set(EXAMPLES) == set(commands())


@pytest.mark.parametrize("path", sorted(EXAMPLES))
def test_the_command_reads_its_example(path: str) -> None:
    first, *words = shlex.split(EXAMPLES[path])
    assert first == "oaisys"
    assert parse(words).startswith(path)


def test_an_example_with_an_unknown_option_is_refused() -> None:
    with pytest.raises(Exception, match="No such option"):
        parse(["doctor", "--such"])


def test_help_shows_groups_and_the_example() -> None:
    shown = CliRunner().invoke(app, ["--help"]).output
    titles = [f"{title}:" for title in GROUPS]
    assert [line for line in shown.splitlines() if line in titles] == titles
    assert f"{OTHERS}:" not in shown
    assert shown.rstrip().endswith(EXAMPLES["oaisys"])
    of_part = CliRunner().invoke(app, ["bag", "info", "--help"]).output
    assert of_part.rstrip().endswith(f"Example:\n    {EXAMPLES['oaisys bag info']}")


def test_commands_of_other_packages_come_last() -> None:
    assert group_names(["render", "mine"]) == {"Render": ["render"], OTHERS: ["mine"]}
