"""Warns of names of the API that have no docstring: a strict build of the site fails on them.

The site's builder loads this file; it imports nothing of ours, as that runs in its own environment.
"""

from __future__ import annotations

import logging
from typing import Any

import griffe

GENERATED = "pb"
"""The package of code that gRPC's tools write."""

LOG = logging.getLogger("mkdocs.plugins.oaisys_docstrings")


class DocstringCheck(griffe.Extension):  # type: ignore[misc] # griffe is of mkdocs' environment
    """Warns of a public class or function without a docstring."""

    def on_class(self, *, cls: Any, **_: Any) -> None:
        """Check a class."""
        _warn_without_docstring(cls)

    def on_function(self, *, func: Any, **_: Any) -> None:
        """Check a function."""
        _warn_without_docstring(func)


def _warn_without_docstring(thing: Any) -> None:
    if not thing.name.startswith("_") and not thing.docstring and _is_public(thing):
        LOG.warning("%s:%s: %s has no docstring", thing.relative_filepath, thing.lineno, thing.path)


def _is_public(thing: Any) -> bool:
    """Return whether neither the thing nor anything that it is part of is private or generated."""
    inside_function = thing.parent is not None and thing.parent.kind is griffe.Kind.FUNCTION
    parts = thing.path.split(".")
    return not inside_function and GENERATED not in parts and not any(p[0] == "_" for p in parts)
