"""Write the tables of docs/licences.md anew: `python -m tools.licences [SITE_PACKAGES ...]`.

Licences come from the metadata of the installed packages, and of ROS packages from their
``package.xml``. Rows of pinned packages that are installed nowhere here stay as they are.
"""

from __future__ import annotations

import argparse
import configparser
import re
import sysconfig
from collections import defaultdict
from collections.abc import Iterable, Mapping
from importlib.metadata import Distribution, distributions
from pathlib import Path
from xml.etree import ElementTree as ET

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE = REPOSITORY / "docs" / "licences.md"
BEGIN, END = "<!-- begin: make licences -->", "<!-- end -->"

SPDX = {
    "Apache 2": "Apache-2.0",
    "Apache 2.0": "Apache-2.0",
    "Apache License 2.0": "Apache-2.0",
    "Apache License, Version 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "3-Clause BSD License": "BSD-3-Clause",
    "BSD 2-Clause License": "BSD-2-Clause",
    "BSD 3-Clause License": "BSD-3-Clause",
    "BSD License": "BSD",
    "FreeBSD": "BSD-2-Clause",
    "GNU General Public License v3 (GPLv3)": "GPL-3.0",
    "ISC License (ISCL)": "ISC",
    "ISC license": "ISC",
    "ISC License": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "New BSD": "BSD-3-Clause",
    "Python Software Foundation License": "PSF-2.0",
    "Simplified BSD license": "BSD-2-Clause",
    "The MIT License (MIT)": "MIT",
}
"""Short names of what metadata say."""

UNSAID = {
    "apsw": "any that the OSI approves",
    "docutils": "public domain, BSD-2-Clause, parts GPL-3.0",
    "empy": "LGPL",
    "mlcroissant": "Apache-2.0",
    "opencolorio": "BSD-3-Clause",
    "openexr": "BSD-3-Clause",
    "python-dateutil": "Apache-2.0 OR BSD-3-Clause",
    "ros-fastcdr": "Apache-2.0",
    "ros-fastrtps": "Apache-2.0",
    "setuptools": "MIT",
}
"""Licences of packages whose metadata name none, or do not say it in a word, from their files."""


def packages_with_pins() -> dict[str, str]:
    """Return the names of all pinned packages as they are written, by normalised name."""
    files = sorted((REPOSITORY / "requirements").glob("*.txt"))
    names = [
        name
        for file in files
        for name in re.findall(r"^([\w.-]+)==", file.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    return {normalise(name): name for name in names}


def direct_dependencies() -> dict[str, list[str]]:
    """Return which of our packages ask for each dependency: ``core``, ``mapping (test)``."""
    users: dict[str, list[str]] = defaultdict(list)
    for file in sorted(REPOSITORY.glob("oaisys_*/setup.cfg")):
        settings = configparser.ConfigParser(interpolation=None)
        settings.read(file, encoding="utf-8")
        short = file.parent.name.removeprefix("oaisys_")
        needs = {short: settings["options"]["install_requires"]}
        for extra, asked in settings["options.extras_require"].items():
            needs[f"{short} ({extra})"] = asked
        for user, asked in needs.items():
            for line in asked.split("\n"):
                name = re.match(r"[\w.-]+", line.strip())
                if name and not name[0].startswith("oaisys_") and user not in users[name[0]]:
                    users[name[0]].append(user)
    return {normalise(name): users[name] for name in users}


def normalise(name: str) -> str:
    """Return a package's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def licence_of(distribution: Distribution) -> str | None:
    """Return the licence of an installed package in a word, or None."""
    metadata = distribution.metadata
    name = normalise(metadata["Name"])
    if name in UNSAID:
        return UNSAID[name]
    classifiers = [
        classifier.rpartition(" :: ")[2]
        for classifier in metadata.get_all("Classifier") or []
        if classifier.startswith("License ::") and "DFSG" not in classifier
    ]
    written = _field(distribution, "License")
    in_a_word = "" if len(written) > 40 or written in ("BSD", "UNKNOWN") else written
    first_line = written.partition("\n")[0]
    said = (
        _field(distribution, "License-Expression")
        or in_a_word
        or ", ".join(classifiers)
        or first_line
    )
    return SPDX.get(said, said) or _licence_in_package_xml(distribution, name) or None


def _field(distribution: Distribution, name: str) -> str:
    values = distribution.metadata.get_all(name) or [""]
    return str(values[0]).strip()


def _licence_in_package_xml(distribution: Distribution, name: str) -> str:
    """Return the licences in the ``package.xml`` that a ROS wheel installs."""
    share = Path(str(distribution.locate_file(""))).parents[2] / "share"
    manifest = share / name.removeprefix("ros-").replace("-", "_") / "package.xml"
    if not manifest.is_file():
        return ""
    # The file is of a package that is installed and runs anyway.
    licences = ET.parse(manifest).getroot().findall("license")  # noqa: S314
    words = [(licence.text or "").strip() for licence in licences]
    return ", ".join(SPDX.get(word, word) for word in words)


def licences_in(folders: Iterable[str]) -> dict[str, str]:
    """Return the licences of pinned packages in some ``site-packages``, by normalised name."""
    pinned = packages_with_pins()
    found: dict[str, str] = {}
    for distribution in distributions(path=list(folders)):
        name = normalise(distribution.metadata["Name"] or "")
        if name in pinned and (licence := licence_of(distribution)):
            found.setdefault(name, licence)
    return found


def licences_on_page(page: str) -> dict[str, str]:
    """Return the licences that the page lists, by normalised name."""
    tables = page.partition(BEGIN)[2].partition(END)[0]
    rows = re.findall(r"^\| ([^|]+) \| ([\w.-]+(?:, [\w.-]+)*) \|$", tables, re.MULTILINE)
    return {normalise(name): licence for licence, names in rows for name in names.split(", ")}


def tables_of(licences: Mapping[str, str]) -> str:
    """Return the two tables of the page.

    Raises:
        SystemExit: The licence of a pinned package is unknown.
    """
    pinned, direct = packages_with_pins(), direct_dependencies()
    unknown = sorted(set(pinned) - set(licences))
    if unknown:
        raise SystemExit(f"no licence is known of {', '.join(unknown)}: install them, or say it")
    lines = ["| direct dependency | licence | of |", "|---|---|---|"]
    lines += [
        f"| `{pinned[name]}` | {licences[name]} | {', '.join(direct[name])} |"
        for name in sorted(direct)
    ]
    groups: dict[str, list[str]] = defaultdict(list)
    for name in sorted(pinned):
        groups[licences[name]].append(pinned[name])
    lines += ["", "| licence | all pinned packages |", "|---|---|"]
    lines += [f"| {licence} | {', '.join(groups[licence])} |" for licence in sorted(groups)]
    return "\n".join(lines)


def main() -> None:
    """Write the tables."""
    parser = argparse.ArgumentParser(prog="python -m tools.licences", description=__doc__)
    parser.add_argument("folders", nargs="*", metavar="SITE_PACKAGES")
    folders = parser.parse_args().folders
    page = PAGE.read_text(encoding="utf-8")
    found = licences_in([sysconfig.get_path("purelib"), *folders])
    before, _, rest = page.partition(BEGIN)
    after = rest.partition(END)[2]
    tables = tables_of({**licences_on_page(page), **found})
    PAGE.write_text(f"{before}{BEGIN}\n{tables}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
