"""Entities that can be spawned: built-in shapes, configured prototypes, mesh files, or JSON."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import unquote, urlparse

from simulation_interfaces.msg import Resource

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_plain_json

MESH_FORMATS = ("obj", "glb", "ply", "blend")
SPAWN_FORMATS = (*MESH_FORMATS, "json")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")
"""Names that the simulator accepts."""

LABEL, FIRST_SEMANTIC_ID = "spawned", 100
"""Of entities without a label, unless the world uses the label or the id already."""

_SOURCES = ("shape", "prototype", "file")


class UnsupportedFormatError(InvalidInputError):
    """A resource is of a kind that cannot be spawned."""


def spec_of(resource: Resource, labels: Mapping[int, str]) -> dict[str, Any]:
    """Return the keys of ``asset.add`` that a resource describes, without those of the pose.

    Args:
        resource: Its URI is ``shape:NAME``, ``prototype:NAME`` or a mesh file's; without one its
            string is a JSON object of the keys.
        labels: Names of the world's semantic ids.

    Raises:
        UnsupportedFormatError: Another kind of URI.
        InvalidInputError: Not a JSON object, or one with a pose.
    """
    if resource.uri:
        return _label(_of_uri(resource.uri), labels)
    try:
        spec = parse_plain_json(resource.resource_string)
    except ValueError as error:
        expected = f"a JSON object ({error})"
        raise InvalidInputError("resource_string", resource.resource_string, expected) from None
    if not isinstance(spec, dict) or {"position_m", "quat_xyzw", "on_ground"} & spec.keys():
        expected = "a JSON object of the keys of asset.add, its pose as initial_pose"
        raise InvalidInputError("resource_string", resource.resource_string, expected)
    return _label(spec, labels)


def stem_of(spec: Mapping[str, Any]) -> str:
    """Return the name, without its number, of an entity that was given none."""
    source = next((str(spec[key]) for key in _SOURCES if spec.get(key)), "")
    stem = re.sub(r"[^A-Za-z0-9]+", "_", PurePosixPath(source).stem).strip("_")
    return stem if NAME.fullmatch(stem) else "entity"


def _of_uri(uri: str) -> dict[str, Any]:
    scheme, _, rest = uri.partition(":")
    if scheme in ("shape", "prototype") and rest:
        return {scheme: rest}
    path = unquote(urlparse(uri).path) if scheme == "file" else uri
    if path.rpartition(".")[2].lower() in MESH_FORMATS and "://" not in path:
        # The pose of an entity is that of its own frame.
        return {"file": path, "anchor": "origin"}
    expected = f"shape:NAME, prototype:NAME or a file of {', '.join(MESH_FORMATS)}"
    raise UnsupportedFormatError("uri", uri, expected)


def _label(spec: dict[str, Any], labels: Mapping[int, str]) -> dict[str, Any]:
    """Return a spec with a label and the semantic id that the label has in this world."""
    if "semantic_id" in spec:
        name = labels.get(spec["semantic_id"]) if isinstance(spec["semantic_id"], int) else None
        return {"label": name or LABEL, **spec}
    label = spec.get("label", LABEL)
    known = [semantic_id for semantic_id, name in sorted(labels.items()) if name == label]
    free = next(i for i in range(FIRST_SEMANTIC_ID, 2**16) if i not in labels)
    return {**spec, "label": label, "semantic_id": known[0] if known else free}
