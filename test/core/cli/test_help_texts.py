"""Each command's help ends with an example that the command itself understands."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from typing import Any

import pytest
import typer
from repository import REPOSITORY
from typer.testing import CliRunner

from oaisys_core.cli.help_texts import EXAMPLES, GROUPS, OTHERS, group_names
from oaisys_core.cli.main import app
from oaisys_core.config import load_config
from oaisys_dataset.records import frame_id


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


def test_examples_read_from_out_only_what_another_example_writes() -> None:
    written, read = set(), []
    for line in EXAMPLES.values():
        words = shlex.split(line)
        for before, word in pairwise(words):
            if not word.startswith("out/"):
                continue
            if before == "--out":
                written.add(word)
            else:
                read.append(word)
    assert len(read) > 10
    for word in read:
        assert any(word == each or word.startswith(f"{each}/") for each in written), word


def test_the_example_of_a_frame_is_one_that_the_example_of_rendering_makes() -> None:
    *_, where, frame = shlex.split(EXAMPLES["oaisys dataset repeat"])
    words = shlex.split(EXAMPLES["oaisys dataset render"])
    assert where == words[words.index("--out") + 1]
    config = load_config(REPOSITORY / words[3])
    assert frame == frame_id(0, 0, config.sensors.cameras[0].name)


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
