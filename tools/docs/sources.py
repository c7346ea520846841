"""Gathers the site's pages in one folder: those of the repository, and those written from code."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

from tools.docs.api_pages import api_pages
from tools.docs.command_page import command_page
from tools.docs.contract_page import contract_page
from tools.docs.links import SiteLinks
from tools.docs.notebook_pages import FOLDER as NOTEBOOK_FOLDER
from tools.docs.notebook_pages import notebook_files, notebook_pages
from tools.docs.tutorial_pages import tutorial_pages
from tools.programs import ROOT

ASSETS = frozenset({".css", ".jpg", ".png", ".svg", ".webp"})

PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "development/contributing.md",
    "SECURITY.md": "development/security.md",
    "QUALITY_DECLARATION.md": "development/quality.md",
    "examples/extensions/README.md": "guides/extensions.md",
    "examples/node/README.md": "guides/node.md",
}
"""Pages outside ``docs/`` by path, and where they are on the site. All in ``docs/`` keep theirs."""

MARK = ".made_by_tools_docs"


def gather_sources(folder: Path) -> None:
    """Write all pages and pictures of the site to a folder, which is emptied first.

    Raises:
        FileExistsError: The folder holds something that this function did not write.
    """
    if folder.exists():
        if not (folder / MARK).is_file():
            raise FileExistsError(f"{folder} was not written by tools.docs; remove it first")
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    (folder / MARK).touch()
    places = dict(_places())
    links = SiteLinks(places)
    for source, target in places.items():
        path = folder / target
        path.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix == ".md":
            text = (ROOT / source).read_text(encoding="utf-8")
            path.write_text(links.rewrite(text, source), encoding="utf-8")
        else:
            shutil.copyfile(ROOT / source, path)
    for name, text in _written_pages():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def _places() -> Iterator[tuple[Path, Path]]:
    """Yield each page and picture, relative to the repository, and its place on the site."""
    for source, target in PAGES.items():
        yield Path(source), Path(target)
    for path in sorted((ROOT / "docs").rglob("*")):
        if path.suffix == ".md" or path.suffix in ASSETS:
            yield path.relative_to(ROOT), path.relative_to(ROOT / "docs")
    for path in notebook_files():
        yield path.relative_to(ROOT), NOTEBOOK_FOLDER / path.name


def _written_pages() -> Iterator[tuple[str, str]]:
    """Yield the pages that are written from code, and their places on the site."""
    yield "reference/commands.md", command_page()
    yield "reference/grpc.md", contract_page()
    yield from api_pages()
    yield from tutorial_pages()
    yield from notebook_pages()
