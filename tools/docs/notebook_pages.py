"""The pages of the notebooks: their texts and code, cell by cell."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

from tools.programs import ROOT

NOTEBOOKS = ROOT / "examples" / "notebooks"
FOLDER = Path("tutorials", "notebooks")
"""Where the pages are on the site, with the notebooks themselves beside them."""

_OTHER_NOTEBOOK = re.compile(r"\]\((\d\d_\w+)\.ipynb\)")
_SCRIPT = re.compile(r"\]\(\.\./(\d\d_\w+)\.py\)")


def notebook_files() -> list[Path]:
    """Return the notebooks in order."""
    return sorted(NOTEBOOKS.glob("[0-9][0-9]_*.ipynb"))


def notebook_pages() -> Iterator[tuple[str, str]]:
    """Yield each page's place on the site and its Markdown."""
    for file in notebook_files():
        yield (FOLDER / f"{file.stem}.md").as_posix(), _page(file)


def _page(file: Path) -> str:
    cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    title, *rest = (_cell(cell) for cell in cells)
    download = f"[Download the notebook]({file.name}); it is `examples/notebooks/{file.name}`."
    return "\n\n".join([title, download, *rest, ""])


def _cell(cell: dict[str, object]) -> str:
    source = cell["source"]
    text = "".join(source) if isinstance(source, list) else str(source)
    if cell["cell_type"] == "code":
        return f"```python\n{text}\n```"
    return _SCRIPT.sub(r"](../\1.md)", _OTHER_NOTEBOOK.sub(r"](\1.md)", text))
