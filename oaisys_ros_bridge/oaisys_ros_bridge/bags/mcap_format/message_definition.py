"""Definitions and hashes of message types, from the installed interface packages."""

from __future__ import annotations

import importlib
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from oaisys_core.errors import NotFoundError, quote

SEPARATOR = "=" * 80
BUILT_IN = re.compile(r"bool|byte|char|w?string|float(32|64)|u?int(8|16|32|64)")
FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[a-z]\w*")
"""Matches the type of a field, and of a constant, which is always of a built-in type."""

TYPE_NAME = re.compile(r"[A-Za-z]\w{0,100}/msg/[A-Za-z]\w{0,100}")
"""Longer ones are no names of files."""


@cache
def message_definition(type_name: str) -> str:
    """Return the definition of a type with those of all nested types, as MCAP stores it.

    The nested ones follow, each after a line of 80 ``=`` and ``MSG: package/Type``.

    Args:
        type_name: Such as ``sensor_msgs/msg/Image``.

    Raises:
        NotFoundError: The package is not installed, or has no such message.
    """
    text = _share_file(type_name, "msg").read_text(encoding="utf-8")
    parts = [text]
    known = {type_name}
    waiting = field_types(type_name, text)
    while waiting:
        nested = waiting.pop(0)
        if nested in known:
            continue
        known.add(nested)
        text = _share_file(nested, "msg").read_text(encoding="utf-8")
        package, _, name = nested.split("/")
        parts.append(f"{SEPARATOR}\nMSG: {package}/{name}\n{text}")
        waiting += field_types(nested, text)
    return "\n".join(parts)


def field_types(type_name: str, definition: str) -> list[str]:
    """Return the message types of a definition's own fields, as ``package/msg/Type``."""
    package = type_name.split("/")[0]
    found = []
    for line in definition.splitlines():
        match = FIELD.match(line.split("#")[0])
        if match is None or BUILT_IN.fullmatch(match[1]):
            continue
        path = match[1].split("/")
        found.append(f"{path[0] if len(path) > 1 else package}/msg/{path[-1]}")
    return found


@cache
def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a message type.

    Raises:
        NotFoundError: The package is not installed, or has no such message.
    """
    description = json.loads(_share_file(type_name, "json").read_text(encoding="utf-8"))
    for entry in description["type_hashes"]:
        if entry["type_name"] == type_name:
            return str(entry["hash_string"])
    raise NotFoundError(f"the description of {type_name} has no hash of it")


def _package_and_name(type_name: str) -> tuple[str, str]:
    """Return the parts of ``package/msg/Type``; bags may name anything as a type."""
    if not TYPE_NAME.fullmatch(type_name):
        raise NotFoundError(f"{quote(type_name)} is no name of a message type")
    package, _, name = type_name.partition("/msg/")
    return package, name


def _share_file(type_name: str, suffix: str) -> Path:
    package, name = _package_and_name(type_name)
    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        raise NotFoundError(f"the package of {quote(type_name)} is not installed") from None
    file = share / "msg" / f"{name}.{suffix}"
    if not file.is_file():
        raise NotFoundError(f"{quote(package)} has no definition of the message {quote(type_name)}")
    return file


def message_class(type_name: str) -> type[Any]:
    """Return the class of ``package/msg/Type``.

    Raises:
        NotFoundError: It is not installed.
    """
    package, name = _package_and_name(type_name)
    try:
        return vars(importlib.import_module(f"{package}.msg"))[name]  # type: ignore[no-any-return]
    except (ImportError, KeyError):
        raise NotFoundError(f"the type {quote(type_name)} is not installed") from None
