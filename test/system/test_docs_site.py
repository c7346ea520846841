"""The documentation site: its links and the pages written from code and notebooks."""

from __future__ import annotations

import json
import re
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import yaml
from repository import REPOSITORY

from tools.docs.api_pages import MODULES
from tools.docs.command_page import command_page
from tools.docs.contract_page import contract_page
from tools.docs.links import REPOSITORY_URL, SiteLinks
from tools.docs.notebook_pages import notebook_files, notebook_pages
from tools.docs.pictures import MOST_BYTES
from tools.docs.sources import gather_sources
from tools.docs.tutorial_pages import tutorial_pages

LINKS = SiteLinks({Path("docs/a.md"): Path("a.md"), Path("README.md"): Path("index.md")})
PROTO = REPOSITORY / "oaisys_grpc" / "proto" / "oaisys" / "v1" / "simulator.proto"


@pytest.mark.parametrize(
    ("link", "expected"),
    [
        ("../README.md#a-drive", "index.md#a-drive"),
        ("../examples/01_one_view.py", "tutorials/01_one_view.md"),
        ("../config/simulator.yaml", f"{REPOSITORY_URL}/config/simulator.yaml"),
        ("https://example.org/a", "https://example.org/a"),
        ("#below", "#below"),
    ],
)
def test_links_lead_to_the_same_thing_on_the_site(link: str, expected: str) -> None:
    assert LINKS.rewrite(f"See [it]({link}).", Path("docs/a.md")) == f"See [it]({expected})."


def test_code_is_left_alone_and_its_links_are_not() -> None:
    text = "`[x](../README.md)` and [`y`](../README.md)"
    assert LINKS.rewrite(text, Path("docs/a.md")) == "`[x](../README.md)` and [`y`](index.md)"


def test_a_link_to_nowhere_is_an_error() -> None:
    with pytest.raises(FileNotFoundError, match=r"docs/a\.md: the link gone\.md leads to no file"):
        LINKS.rewrite("[x](gone.md)", Path("docs/a.md"))


def test_a_folder_of_others_is_not_emptied(tmp_path: Path) -> None:
    (tmp_path / "precious").touch()
    with pytest.raises(FileExistsError, match="remove it first"):
        gather_sources(tmp_path)
    assert (tmp_path / "precious").exists()


def test_every_tutorial_has_a_picture_that_loads_quickly() -> None:
    tutorials = sorted((REPOSITORY / "examples").glob("[0-9]*.py"))
    pages = dict(tutorial_pages())
    for example in tutorials:
        picture = REPOSITORY / "docs" / "tutorials" / f"{example.stem}.webp"
        assert 0 < picture.stat().st_size <= MOST_BYTES
        assert f"]({picture.name})" in pages[f"tutorials/{example.stem}.md"]


def test_notebooks_hold_no_output_and_are_on_the_site() -> None:
    pages = dict(notebook_pages())
    assert len(pages) == len(notebook_files()) == 3
    for file in notebook_files():
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        assert not any(cell.get("outputs") for cell in cells)
        code = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
        page = pages[f"tutorials/notebooks/{file.stem}.md"]
        assert all("".join(source) in page for source in code)


def test_every_command_has_its_section_and_options() -> None:
    page = command_page()
    for name in entry_points(group="oaisys.commands").names:
        assert f"## oaisys {name}\n" in page
    assert "### oaisys dataset export\n" in page
    assert "`--look-at" in page


def test_every_message_and_method_of_the_contract_is_on_its_page() -> None:
    """The names are looked for in the proto's text, not with the parser that the page uses."""
    text, page = PROTO.read_text(encoding="utf-8"), contract_page()
    for name in re.findall(r"^ *(?:rpc|message|enum) (\w+)", text, re.MULTILINE):
        assert re.search(rf"^### (?:\w+\.)*{name}( |$)", page, re.MULTILINE), name
    assert "Depth and labels before RGB" in page.replace("depth and labels", "Depth and labels")


def test_every_page_that_is_written_is_in_the_navigation() -> None:
    # The file has a tag of Python for mkdocs, which is of no matter here.
    text = (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8").replace("!!python/", "!python-")
    nav = set(re.findall(r"[\w/]+\.md", text.partition("\nnav:")[2]))
    assert yaml.safe_load("nav:" + text.partition("\nnav:")[2])["nav"]
    assert {name for name, _ in tutorial_pages()} <= nav
    assert {f"reference/api/{name}.md" for name in MODULES} <= nav
