"""Where the meshes of a robot are: ``package://``, ``model://``, ``file://`` and relative paths."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import read_text
from oaisys_core.files.references import lies_within

FIELD = "robot.mesh"
MOST_PARENTS = 12
"""Folders above the robot's file in which its package or model is looked for."""

ENVIRONMENT = (
    *("ROS_PACKAGE_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH"),
    *("SDF_PATH", "GAZEBO_MODEL_PATH"),
)
MANIFESTS = ("package.xml", "model.config")
_ADDRESS = re.compile(r"([a-z][a-z0-9+.-]*)://(.*)", re.IGNORECASE | re.DOTALL)
_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")

HINT = "--packages FOLDER says where packages and models are"


class MeshResources:
    """Finds the meshes that a robot's file names.

    Args:
        file: The robot's file.
        packages: Folders that are packages or models, or contain them.
    """

    def __init__(self, file: Path, packages: Sequence[Path] = ()) -> None:
        self._folder = file.resolve().parent
        self._given = tuple(folder.resolve() for folder in packages)

    def find(self, uri: str) -> tuple[Path, Path]:
        """Return the path of a mesh, and the folder of what it belongs to, links resolved.

        Raises:
            InvalidInputError: It is not there, in the net, or outside of the package or model that
                it is named from.
        """
        address = _ADDRESS.fullmatch(uri)
        scheme, rest = ("", uri) if address is None else (address[1].lower(), address[2])
        rest = unquote(rest).replace("\\", "/")
        if "\0" in rest or scheme not in ("", "file", "package", "model"):
            expected = "package://, model://, file:// or a path; download what is in the net"
            raise InvalidInputError(FIELD, uri, expected)
        if scheme in ("package", "model"):
            name, _, inner = rest.lstrip("/").partition("/")
            folders = list(self._named(name))
            if not folders:
                raise InvalidInputError(FIELD, uri, f"a {scheme} that can be found; {HINT}")
            places = [(folder / inner, folder) for folder in folders]
        else:
            places = [(self._folder / rest, root) for root in self._roots()]
        return self._existing(uri, places)

    def _existing(self, uri: str, places: list[tuple[Path, Path]]) -> tuple[Path, Path]:
        inside = [(path, root) for path, root in places if lies_within(path, (root,))]
        if not inside:
            raise InvalidInputError(FIELD, uri, f"a file in the robot's package or model; {HINT}")
        for path, root in inside:
            if path.is_file():
                return path.resolve(), root
        raise InvalidInputError(FIELD, uri, f"an existing file; {HINT}")

    def _roots(self) -> Iterator[Path]:
        """Yield the folders in which plain paths may lead."""
        above = [self._folder, *self._folder.parents][:MOST_PARENTS]
        owner = next((each for each in above if _has_manifest(each)), self._folder.parent)
        yield owner if owner != Path(owner.anchor) else self._folder
        yield from self._given

    def _named(self, name: str) -> Iterator[Path]:
        """Yield the folders of a package or model, the nearest first."""
        if not name or name in (".", ".."):
            return
        above = [self._folder, *self._folder.parents][:MOST_PARENTS]
        for folder in (*self._given, *above, *_environment_folders()):
            if folder.name == name or _manifest_name(folder) == name:
                yield folder
            if (folder / name).is_dir():
                yield (folder / name).resolve()


def _has_manifest(folder: Path) -> bool:
    return any((folder / name).is_file() for name in MANIFESTS)


def _manifest_name(folder: Path) -> str | None:
    """Return the name of a ROS package, whose folder may have another one."""
    try:
        found = _NAME.search(read_text(folder / MANIFESTS[0], 100_000))
    except (OSError, ValueError):
        return None
    return None if found is None else found[1]


def _environment_folders() -> Iterator[Path]:
    for folder in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if folder:
            yield Path(folder, "share")
    for name in ENVIRONMENT:
        for folder in os.environ.get(name, "").split(os.pathsep):
            if folder:
                yield Path(folder)
