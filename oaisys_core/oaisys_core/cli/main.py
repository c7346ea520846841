"""The ``oaisys`` command, whose sub-commands come from the installed packages.

A package adds a sub-command through the entry point group ``oaisys.commands``: a function with
typer annotations, or a `typer.Typer` with sub-commands of its own. A function ends normally
(exit 0), raises an `OaisysError`, or raises `typer.Exit`.
"""

from __future__ import annotations

import inspect
import logging
import re
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, wraps
from importlib.metadata import EntryPoint, entry_points, version
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from oaisys_core.cli.help_texts import add_examples, epilog_of, group_names
from oaisys_core.errors import ConfigError, InvalidInputError, OaisysError, did_you_mean
from oaisys_core.files.folders import user_path
from oaisys_core.system.ending.signals import (
    RECEIVED,
    end_at_signal,
    has_dropped_interruption,
    ignore_signals,
    interrupt_at_signals,
    work_in_child,
)
from oaisys_core.system.shortages import shortage
from oaisys_core.system.standard_streams import printable

COMMAND_GROUP = "oaisys.commands"
PROGRAM = "oaisys"
PLAIN_HELP = None
"""Plain help instead of rich's tables, which are too narrow at 80 columns."""

_HAS_CHECKS = "has_checks"
"""Mark of a command whose values are checked before it runs; applications are loaded twice."""

EXIT_FAILED = 1
EXIT_INVALID_INPUT = 2
EXIT_INTERRUPTED = 130

IN_CHILD = frozenset(
    {"audit", "certificate", "dataset", "drive", "evaluate", "heights", "place", "render", "repeat"}
)
"""Commands that work in a child process, see `oaisys_core.system.ending.signals`: what takes long
may be inside of a library, which heeds no signal."""

WITH_HANDLERS = frozenset(
    {"certificate issue", "explore", "live", "record", "serve", "survey", "view"}
)
"""Commands that start and end processes of their own, or nodes, and handle signals themselves.

Until they do there is nothing to be cleaned up, so that a signal ends the process at once: an
exception would be raised in the middle of imports, and some libraries drop it there."""

GRACE_S = {"drive": 4.0}
"""How long a command may take to complete its files at a signal; a drive closes its bag."""


class _Commands(TyperGroup):
    """Suggests a similar name for an unknown command."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, known = args[0], self.list_commands(ctx)
        if name not in known and not name.startswith("-") and (hint := did_you_mean(name, known)):
            ctx.fail(f"No such command {name!r}{hint}.")
        return super().resolve_command(ctx, args)


class _InstalledCommands(_Commands):
    """Imports the module of a sub-command only when that command is used."""

    def list_commands(self, ctx: Any) -> list[str]:
        return sorted(_commands_by_name())

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in groups."""
        names = self.list_commands(ctx)
        widest = max(map(len, names), default=0)
        for title, group in group_names(names).items():
            rows = [
                (f"{name:<{widest}}", command.short_help or "")
                for name in group
                if (command := self.get_command(ctx, name)) is not None
            ]
            with formatter.section(title):
                formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; for an unknown choice of an option, suggest a similar one."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            received, *choices = re.findall("'([^']*)'", error.message) or [""]
            error.message += did_you_mean(received, choices)
            raise

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command; before it is imported, a long one goes on in a child process."""
        has_handlers = bool(WITH_HANDLERS.intersection((args[0], " ".join(args[:2]))))
        is_in_child = args[0] in IN_CHILD and not has_handlers and "--help" not in args
        if _is_program and is_in_child:
            work_in_child(args[0], GRACE_S.get(args[0], 0.0))
        command = super().resolve_command(ctx, args)
        if _is_program and not (is_in_child or has_handlers):
            interrupt_at_signals()
        return command

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        entry = _commands_by_name().get(cmd_name)
        return None if entry is None else _load(entry)


@cache
def _commands_by_name() -> Mapping[str, EntryPoint]:
    """Return the sub-commands by name; searching all installed packages takes 30 ms."""
    return {entry.name: entry for entry in reversed(list(entry_points(group=COMMAND_GROUP)))}


def _load(entry: EntryPoint) -> Any:
    """Return the typer command of an entry; if it cannot be imported, one that reports why."""
    try:
        target = entry.load()
    except (ImportError, AttributeError) as error:
        target = _unavailable(entry, shortage(error) or error)
    if not isinstance(target, typer.Typer):
        target = _with_checks(target)
        app = typer.Typer(add_completion=False)
        app.command(entry.name)(target)
        target = app
    else:
        _check_values(target)
        if not isinstance(target.info.cls, type):
            target.info.cls = _Commands
    target.rich_markup_mode = PLAIN_HELP
    command = typer.main.get_command(target)
    command.name = entry.name
    _refuse_empty_texts(command)
    _summarise(command)
    add_examples(command, f"{PROGRAM} {entry.name}")
    return command


def _check_values(app: typer.Typer) -> None:
    """Have the values of all commands of an application checked."""
    callback = app.registered_callback
    for info in (*app.registered_commands, *([callback] if callback else ())):
        if info.callback is not None:
            info.callback = _with_checks(info.callback)
    for group in app.registered_groups:
        if group.typer_instance is not None:
            _check_values(group.typer_instance)


def _with_checks(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command that is given its paths as `user_path` reads them, and finite numbers."""
    if hasattr(function, _HAS_CHECKS):
        return function

    @wraps(function)
    def command(**values: Any) -> Any:
        return function(**{name: _checked(value, name) for name, value in values.items()})

    setattr(command, _HAS_CHECKS, True)
    return command


def _checked(value: Any, name: str) -> Any:
    if isinstance(value, Path):
        return user_path(value, name)
    if isinstance(value, float) and not isfinite(value):
        raise InvalidInputError(name.replace("_", "-"), value, "a finite number")
    if isinstance(value, list | tuple):
        return type(value)(_checked(each, name) for each in value)
    return value


def _refuse_empty_texts(command: Any) -> None:
    """Have each command refuse options and arguments of empty text, as of an unset "$OUT".

    A path of empty text is the current folder. Where empty text is the default, it stays one.
    """
    for parameter in command.params:
        if parameter.default != "":
            parameter.consume_value = _not_empty(parameter, parameter.consume_value)
    for part in getattr(command, "commands", {}).values():
        _refuse_empty_texts(part)


def _not_empty(parameter: Any, consume_value: Callable[..., Any]) -> Callable[..., Any]:
    """Return a parameter's method that finds its value, before it becomes a path, with a check."""

    def consume(ctx: Any, opts: Any) -> Any:
        value, source = consume_value(ctx, opts)
        if value == "" or (isinstance(value, list | tuple) and "" in value):
            is_option = parameter.param_type_name == "option"
            shown = parameter.metavar or parameter.name.upper()
            name = max(parameter.opts, key=len) if is_option else shown.rstrip(".")
            raise InvalidInputError(name, "", "text that is not empty; is a variable unset?")
        return value, source

    return consume


def _summarise(command: Any) -> None:
    """Show the whole first paragraph of each command in lists, not only 50 letters."""
    if not command.short_help and command.help:
        command.short_help = " ".join(inspect.cleandoc(command.help).split("\n\n")[0].split())
    for part in getattr(command, "commands", {}).values():
        _summarise(part)


def _unavailable(entry: EntryPoint, error: Exception) -> typer.Typer:
    app = typer.Typer(add_completion=False)
    context = {"ignore_unknown_options": True, "allow_extra_args": True}

    @app.command(entry.name, context_settings=context, help=f"(not available: {error})")
    def explain() -> None:
        raise OaisysError(f"the command '{entry.name}' is not available: {error}")

    return app


app = typer.Typer(cls=_InstalledCommands, add_completion=False, rich_markup_mode=PLAIN_HELP)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"oaisys {version('oaisys_core')}")
        raise typer.Exit


@app.callback(no_args_is_help=True, epilog=epilog_of(PROGRAM))
def _configure(
    verbose: Annotated[
        int, typer.Option("--verbose", "-v", count=True, help="Log progress; twice for details.")
    ] = 0,
    _version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version."),
    ] = False,
) -> None:
    """Interactive OAISYS: photorealistic terrain for planners, one sample at a time."""
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(level=level, format="%(levelname)s %(name)s: %(message)s")


_is_program = False


def run_program() -> NoReturn:
    """Run `main` as a program of its own, which ends at a signal with 128 and its number."""
    global _is_program
    _is_program = True
    try:
        main()
    except BaseException as end:
        # Commands whose end is a signal, such as `view`, have ended well.
        has_ended_well = isinstance(end, SystemExit) and not end.code
        if RECEIVED and (not has_ended_well or has_dropped_interruption()):
            end_at_signal(RECEIVED[0])
        if RECEIVED:
            ignore_signals()
        raise
    sys.exit(0)


def main() -> None:
    """Run the command line and exit: 0 done, 1 the job failed, 2 the input was wrong."""
    try:
        typer.main.get_command(app).main(prog_name=PROGRAM)
    except (InvalidInputError, ConfigError) as error:
        sys.exit(_report(error, EXIT_INVALID_INPUT))
    except OaisysError as error:
        sys.exit(_report(error, EXIT_FAILED))
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except (MemoryError, OSError, RuntimeError, ImportError) as error:
        if (told := _failure(error)) is None:
            raise
        sys.exit(_report(told, EXIT_FAILED))


def _failure(error: Exception) -> OaisysError | None:
    """Return an error that says what the machine refused; None if the fault is our own."""
    told = shortage(error)
    if told is None and isinstance(error, OSError) and error.errno is not None:
        where = f"{error.filename}: " if error.filename else ""
        return OaisysError(f"{where}{error.strerror}")
    return told


def _report(error: OaisysError, exit_code: int) -> int:
    """Print an error and return the exit code; ``-vv`` shows where the error comes from, too."""
    logging.getLogger(__name__).debug("", exc_info=error)
    lines = [f"oaisys: {error}", *getattr(error, "__notes__", ())]
    with suppress(OSError):  # standard error is full or gone
        typer.echo(printable("\n".join(lines)), err=True)
    return exit_code
