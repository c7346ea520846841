"""What can be said to the launch files, held to what the commands take; needs no launch system."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, get_args, get_type_hints

import pytest
import typer
from repository import REPOSITORY

from oaisys_ros_bridge.experiments.explore.command import explore
from oaisys_ros_bridge.experiments.survey.command import survey
from oaisys_ros_bridge.launching.arguments import (
    DRIVE,
    EXPLORE,
    OPTIONS,
    RVIZ,
    SIMULATOR,
    SURVEY,
    SWITCH,
    Argument,
    command_line,
)

LAUNCH_FILES = REPOSITORY / "launch"
TABLES = {"survey": SURVEY, "explore": EXPLORE, "simulator": SIMULATOR, "drive": DRIVE}
COMMANDS: dict[str, Callable[..., None]] = {"survey": survey, "explore": explore}


def options_of(name: str) -> dict[str, Any]:
    """Return a command's options by their argument's name."""
    app = typer.Typer(add_completion=False)
    app.command(name)(COMMANDS[name])
    command: Any = typer.main.get_command(app)
    renamed = {option: argument for argument, option in OPTIONS.items()}
    return {renamed.get(p.name, p.name): p for p in command.params if p.name != "help"}


@pytest.mark.parametrize("name", TABLES)
def test_a_launch_file_has_its_table(name: str) -> None:
    tree = ast.parse((LAUNCH_FILES / f"{name}.launch.py").read_text(encoding="utf-8"))
    called = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    handed = {a.id for call in called for a in call.args if isinstance(a, ast.Name)}
    assert name.upper() in handed
    assert {file.name for file in LAUNCH_FILES.glob("*.py")} == {f"{n}.launch.py" for n in TABLES}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_of_an_experiment_is_an_argument_with_its_default(name: str) -> None:
    options = options_of(name)

    assert set(TABLES[name]) == set(options)
    for argument_name, argument in TABLES[name].items():
        default = options[argument_name].default
        if isinstance(default, bool):
            assert argument.choices == SWITCH
            assert argument.default == str(default).lower(), argument_name
        else:
            usual = "" if default is None else str(getattr(default, "value", default))
            assert argument.default == usual, argument_name


@pytest.mark.parametrize("name", COMMANDS)
def test_the_command_understands_every_argument(name: str) -> None:
    """Values that are not the usual ones arrive as what they say."""
    app = typer.Typer(add_completion=False)
    app.command(name)(COMMANDS[name])
    command: Any = typer.main.get_command(app)
    hints = get_type_hints(COMMANDS[name])
    usual = {key: argument.default for key, argument in TABLES[name].items()}
    assert command_line(TABLES[name], usual) == []

    for key, argument in TABLES[name].items():
        value = another(argument, hints[OPTIONS.get(key, key)])
        line = command_line(TABLES[name], {**usual, key: value})
        assert line, key
        context = command.make_context(name, line)
        found = context.params[OPTIONS.get(key, key)]
        (found,) = found if isinstance(found, list) else (found,)  # an option that may be repeated
        said = str(found).lower() if isinstance(found, bool) else getattr(found, "value", found)
        assert str(said) == value


def another(argument: Argument, hint: Any) -> str:
    """Return a value of an argument that is not its default."""
    for choice in argument.choices:
        if choice not in ("", argument.default):
            return choice
    kinds = (hint, *get_args(hint))
    if int in kinds:
        return "7"
    if float in kinds:
        return "0.75" if argument.default == "1.0" else "1.0"
    return "another"


def test_all_nodes_can_be_given_parameters_a_log_level_and_a_clock() -> None:
    for table in TABLES.values():
        assert {"params_file", "log_level", "use_sim_time"} <= table.keys()
    for argument in [RVIZ, *(a for table in TABLES.values() for a in table.values())]:
        assert len(argument.description) > 20
