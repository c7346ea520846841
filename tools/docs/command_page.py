"""The page of all commands, from the options that the code declares."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import typer

from oaisys_core.cli.help_texts import EXAMPLES
from oaisys_core.cli.main import app

HEAD = """# Commands in full

Every command and option, written from the code. [Commands](../commands.md) says what each is for.
Exit codes: 0 done, 1 the job failed, 2 the input was wrong.
"""


def command_page() -> str:
    """Return the page in Markdown."""
    root = typer.main.get_command(app)
    return "\n".join([HEAD, *_sections(root, None, "oaisys")])


def _sections(command: Any, parent: Any, name: str) -> Iterator[str]:
    """Yield a command's lines, then those of its sub-commands."""
    context = type(_context_of(command, name))(command, info_name=name, parent=parent)
    if parent is not None:
        yield f"{'##' if parent.parent is None else '###'} {name_of(context)}\n"
    yield inspect.cleandoc(command.help or "") + "\n"
    usage = " ".join(command.collect_usage_pieces(context))
    yield f"```text\n{name_of(context)} {usage}\n```\n"
    if example := EXAMPLES.get(name_of(context)):
        yield f"```bash\n{example}\n```\n"
    yield from _options(command, context)
    for part in _parts(command, context):
        yield from _sections(part, context, part.name)


def _context_of(command: Any, name: str) -> Any:
    return command.make_context(name, [], resilient_parsing=True)


def name_of(context: Any) -> str:
    """Return a command's name with those of all that it is part of."""
    return str(context.command_path).split(" [")[0]


def _parts(command: Any, context: Any) -> list[Any]:
    names = command.list_commands(context) if hasattr(command, "list_commands") else []
    return [part for name in names if (part := command.get_command(context, name))]


def _options(command: Any, context: Any) -> Iterator[str]:
    """Yield the table of options and arguments."""
    records = [param.get_help_record(context) for param in command.get_params(context)]
    rows = [(_cell(names), _cell(meaning)) for names, meaning in filter(None, records)]
    if rows:
        yield "| option | meaning |\n|---|---|"
        yield from (f"| `{names}` | {meaning} |" for names, meaning in rows)
        yield ""


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
