"""All packages have one version: that of the file VERSION."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from catkin_pkg.changelog import get_changelog_from_path
from catkin_pkg.package import parse_package
from repository import REPOSITORY

import oaisys_core

VERSION = (REPOSITORY / "VERSION").read_text(encoding="ascii").strip()
PACKAGES = sorted(file.parent for file in REPOSITORY.glob("oaisys_*/package.xml"))
DOCUMENTS = ("README.md", "CHANGELOG.rst", "resource")
PYTHON_PACKAGES = [package for package in PACKAGES if (package / "setup.cfg").is_file()]


def name_of(package: Path) -> str:
    return package.name


def test_the_version_is_one_that_package_xml_may_have() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", VERSION)
    assert [package.name for package in set(PACKAGES) - set(PYTHON_PACKAGES)] == ["oaisys_msgs"]


@pytest.mark.parametrize("package", PACKAGES, ids=name_of)
def test_package_xml_has_the_version(package: Path) -> None:
    assert parse_package(str(package)).version == VERSION


@pytest.mark.parametrize("package", PYTHON_PACKAGES, ids=name_of)
def test_the_package_reads_its_version_from_the_file(package: Path) -> None:
    link = package / package.name / "VERSION"
    assert link.resolve() == REPOSITORY / "VERSION"
    settings = (package / "setup.cfg").read_text(encoding="utf-8")
    assert f"version = file: {package.name}/VERSION" in settings


@pytest.mark.parametrize("package", PYTHON_PACKAGES, ids=name_of)
def test_the_installed_package_has_the_version(package: Path) -> None:
    assert version(package.name) == VERSION, "run `make setup`"


def test_the_module_says_the_version() -> None:
    assert oaisys_core.__version__ == VERSION


def test_the_newest_entry_of_the_changelog_is_the_version() -> None:
    entries = re.findall(r"^## (\d\S*) \((\d{4}-\d\d-\d\d)\)$", changelog(), re.MULTILINE)
    assert entries[0][0] == VERSION
    numbers = [tuple(map(int, number.split("."))) for number, _ in entries]
    assert numbers == sorted(numbers, reverse=True)
    dates = [date for _, date in entries]
    assert dates == sorted(dates, reverse=True)


def test_every_entry_of_the_changelog_is_a_version_with_a_date() -> None:
    titles = re.findall(r"^## (.+)$", changelog(), re.MULTILINE)
    dated = re.compile(r"\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\)")
    assert titles[0] == "Unreleased"
    assert [title for title in titles[1:] if not dated.fullmatch(title)] == []


def changelog() -> str:
    return (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("package", PACKAGES, ids=name_of)
def test_the_changelog_of_a_package_has_the_versions_of_the_repository(package: Path) -> None:
    dates = dict(re.findall(r"^## (\d\S*) \((\S+)\)$", changelog(), re.MULTILINE))
    entries = get_changelog_from_path(str(package / "CHANGELOG.rst")).foreach_version(reverse=True)
    own = {version: f"{date:%Y-%m-%d}" for version, date, _ in entries}
    assert next(iter(own)) == VERSION
    assert own.items() <= dates.items()


def test_the_citation_has_version_and_date() -> None:
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    date = re.search(rf"^## {re.escape(VERSION)} \((\S+)\)$", changelog(), re.MULTILINE)
    assert date is not None
    assert citation["version"] == VERSION
    assert str(citation["date-released"]) == date[1]


@pytest.mark.parametrize("package", PACKAGES, ids=name_of)
def test_package_xml_says_who_made_it_and_where_it_is(package: Path) -> None:
    manifest = parse_package(str(package))
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    addresses = {url.type: url.url for url in manifest.urls}
    assert set(addresses) == {"website", "repository", "bugtracker"}
    assert addresses["repository"] == citation["repository-code"]
    assert all(url.startswith(addresses["repository"]) for url in addresses.values())
    assert [author.name for author in manifest.authors] == ["The OAISYS developers"]
    assert manifest.maintainers
    manifest.validate()


def test_an_sdist_holds_the_version_itself(tmp_path: Path) -> None:
    """A link would lead nowhere where somebody unpacks it."""
    package = REPOSITORY / "oaisys_mapping"
    copy = tmp_path / package.name
    copy.mkdir()
    for name in (
        "CHANGELOG.rst",
        "resource",
        "setup.cfg",
        "setup.py",
        "pyproject.toml",
        "package.xml",
        "README.md",
    ):
        (copy / name).symlink_to(package / name)
    (copy / package.name).mkdir()
    (copy / package.name / "__init__.py").touch()
    (tmp_path / "VERSION").write_text("7.8.9\n", encoding="ascii")
    (copy / package.name / "VERSION").symlink_to("../../VERSION")
    build = "from setuptools import build_meta; build_meta.build_sdist('..')"
    command = [sys.executable, "-c", build]
    subprocess.run(command, cwd=copy, check=True, capture_output=True, timeout=60)
    with tarfile.open(tmp_path / f"{package.name}-7.8.9.tar.gz") as archive:
        member = archive.getmember(f"{package.name}-7.8.9/{package.name}/VERSION")
        assert member.isfile()


@pytest.mark.parametrize("folder", ["launch", "config"])
def test_the_bridge_has_the_repositorys_launch_files_and_configurations(folder: str) -> None:
    """As links, because an sdist holds nothing that is outside of its package."""
    assert (REPOSITORY / "oaisys_ros_bridge" / folder).resolve() == REPOSITORY / folder
