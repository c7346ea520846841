"""SciPy's import, without parsing the docstrings of its functions.

When it is imported, SciPy parses the docstrings of hundreds of its functions and writes them anew
with a note on the array libraries that each takes. An import hook puts `KeptDocstring` in the place
of the parser, which leaves the docstrings as they stand in the source.

Private part: the class ``FunctionDoc`` in ``scipy._lib._docscrape``.
Tried with: SciPy 1.17.1.
Public way without it: SciPy is imported as usual.
Lost without it: a quarter of a second of processor time in each process that renders, and 0.4 s
    where ``scipy.stats`` is imported. (With it: those notes, where somebody calls ``help``.)
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from types import ModuleType
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

PARSER = "scipy._lib._docscrape"
PARSED = "FunctionDoc"
"""The class in `PARSER` that SciPy's decorators call with a function."""


class KeptDocstring:
    """The docstring of a function; what SciPy adds to its sections is not written into it."""

    def __init__(self, function: Any) -> None:
        self._text = function.__doc__ or ""
        self._sections: dict[str, list[Any]] = defaultdict(list)

    def __getitem__(self, section: str) -> list[Any]:
        """Return a section without parameters or paragraphs."""
        return self._sections[section]

    def __setitem__(self, section: str, content: list[Any]) -> None:
        """Replace a section."""
        self._sections[section] = content

    def __str__(self) -> str:
        """Return the docstring after a line for the signature, which SciPy removes."""
        return f"\n{self._text}"


class SciPyGuard:
    """An import hook that finds `PARSER` alone."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Have `PARSER` loaded with `KeptDocstring`; other finders find all other modules."""
        if fullname != PARSER:
            return None
        found = PathFinder.find_spec(fullname, path)
        if found is None or found.origin is None or not found.origin.endswith(".py"):
            return None
        return spec_from_file_location(fullname, loader=_ParserLoader(fullname, found.origin))


class _ParserLoader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        if hasattr(module, PARSED):
            setattr(module, PARSED, KeptDocstring)
        else:
            reason, instead = f"{PARSER} has no {PARSED}", "its import takes 0.2 s longer"
            report_fallback("SciPy's parser of docstrings", reason, instead)


def guard_scipy() -> None:
    """Install the import hook if it is not installed yet."""
    if not any(isinstance(finder, SciPyGuard) for finder in sys.meta_path):
        sys.meta_path.insert(0, SciPyGuard())
