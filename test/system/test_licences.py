"""docs/licences.md lists the licence of each package that is pinned or asked for."""

from __future__ import annotations

import sysconfig

import pytest
from repository import REPOSITORY

from tools import licences

PAGE = licences.PAGE.read_text(encoding="utf-8")


def test_every_pinned_package_is_listed() -> None:
    assert licences.licences_on_page(PAGE).keys() == licences.packages_with_pins().keys()


def test_every_direct_dependency_is_pinned_and_listed_with_who_asks_for_it() -> None:
    direct, pinned = licences.direct_dependencies(), licences.packages_with_pins()
    assert direct.keys() <= pinned.keys()
    for name, users in direct.items():
        row = f"| `{pinned[name]}` | {licences.licences_on_page(PAGE)[name]} | {', '.join(users)} |"
        assert row in PAGE


def test_the_licences_are_those_of_the_installed_packages() -> None:
    """Versions that only one Python has may say theirs in other words."""
    installed = licences.licences_in([sysconfig.get_path("purelib")])
    files = (REPOSITORY / "requirements").glob("py3*.txt")
    lines = [set(file.read_text(encoding="utf-8").split()) for file in files]
    same = {licences.normalise(line.partition("==")[0]) for line in set.intersection(*lines)}
    listed = licences.licences_on_page(PAGE)
    assert len(same & installed.keys()) > 0.8 * len(listed)
    said = {name: installed[name] for name in same & installed.keys()}
    assert said.items() <= listed.items(), "run `make licences`"


def test_tables_can_be_read_back() -> None:
    listed = licences.licences_on_page(PAGE)
    again = f"{licences.BEGIN}\n{licences.tables_of(listed)}\n{licences.END}"
    assert again in PAGE
    assert licences.licences_on_page(again) == listed


def test_a_package_without_a_known_licence_is_named() -> None:
    listed = licences.licences_on_page(PAGE)
    del listed["numpy"]
    with pytest.raises(SystemExit, match="numpy"):
        licences.tables_of(listed)
