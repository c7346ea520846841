"""The pages of the tutorials: each is a numbered example, its docstring the text."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tools.docs.notebook_pages import NOTEBOOKS
from tools.programs import ROOT

EXAMPLES = ROOT / "examples"
PICTURES = ROOT / "docs" / "tutorials"

INDEX = """# Tutorials

Each tutorial is a program of some forty lines in `examples/`. The tests run all of them.
Pictures are made by running them. The first three are also notebooks, for Jupyter.
"""


def tutorial_pages() -> Iterator[tuple[str, str]]:
    """Yield each page's place on the site and its Markdown, the list of all first."""
    files = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
    rows = [f"{number}. [{_title(file)}]({file.stem}.md)" for number, file in enumerate(files, 1)]
    yield "tutorials/index.md", "\n".join([INDEX, *rows, ""])
    for file in files:
        yield f"tutorials/{file.stem}.md", _page(file)


def _docstring(file: Path) -> str:
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
    if text is None:
        raise ValueError(f"{file}: an example needs a docstring, which is its page")
    return text


def _title(file: Path) -> str:
    """Return the first sentence of an example's docstring, up to a colon."""
    return re.split(r"[:.,](?:\s|$)", _docstring(file), maxsplit=1)[0]


def _page(file: Path) -> str:
    code = file.read_text(encoding="utf-8").split('"""', 2)[2].strip()
    picture = PICTURES / f"{file.stem}.webp"
    shown = [f"![What it shows]({picture.name})\n"] if picture.is_file() else []
    parts = [f"# {_title(file)}\n", _docstring(file) + "\n", *shown]
    title = f"examples/{file.name}"
    parts.append(f'```python title="{title}"\n{code}\n```\n')
    if (NOTEBOOKS / f"{file.stem}.ipynb").is_file():
        parts.append(f"The same, step by step: [as a notebook](notebooks/{file.stem}.md).\n")
    return "\n".join(parts)
