"""What may stand where in the JSON of a glTF file: objects, lists, and indices of entries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oaisys_core.errors import quote

_NAMED: dict[str, Any] = {"*": {}}
"""An object of objects, as extensions are."""

_TEXTURE = {"index": "textures", "extensions": _NAMED}

_STRUCTURE: dict[str, Any] = {
    "asset": {"extensions": _NAMED},
    "scene": "scenes",
    "extensionsUsed": [str],
    "extensionsRequired": [str],
    "scenes": [{"nodes": ["nodes"]}],
    "nodes": [{"mesh": "meshes", "skin": "skins", "children": ["nodes"], "extensions": _NAMED}],
    "meshes": [
        {
            "primitives": [
                {
                    "attributes": {"*": "accessors"},
                    "targets": [{"*": "accessors"}],
                    "indices": "accessors",
                    "material": "materials",
                    "mode": int,
                    "extensions": _NAMED,
                }
            ]
        }
    ],
    "accessors": [
        {
            "bufferView": "bufferViews",
            "byteOffset": int,
            "componentType": int,
            "count": int,
            "type": str,
            "sparse": {
                "count": int,
                "indices": {"bufferView": "bufferViews", "byteOffset": int, "componentType": int},
                "values": {"bufferView": "bufferViews", "byteOffset": int},
            },
        }
    ],
    "bufferViews": [{"buffer": "buffers", "byteOffset": int, "byteLength": int, "byteStride": int}],
    "buffers": [{"byteLength": int, "uri": str}],
    "materials": [
        {
            "pbrMetallicRoughness": {"baseColorTexture": _TEXTURE},
            "extensions": {"*": {"diffuseTexture": _TEXTURE}},
        }
    ],
    "textures": [
        {"source": "images", "sampler": "samplers", "extensions": {"*": {"source": "images"}}}
    ],
    "images": [{"bufferView": "bufferViews", "uri": str}],
    "samplers": [{"wrapS": int, "wrapT": int}],
    "skins": [{"joints": ["nodes"], "inverseBindMatrices": "accessors"}],
    "animations": [{}],
    "cameras": [{}],
}
"""By the schema of glTF 2.0: a dict is an object (``*``: any other key), a list one of such
entries, a text the list of which a value is an index, and a type one that is not negative."""


_KINDS: tuple[tuple[Any, str], ...] = (
    (dict, "an object"),
    (list, "a list"),
    (str, "text"),
    (int, "a whole number of 0 or more"),
)
"""The kinds of values that are no indices, and what errors call them."""


def check_structure(document: Mapping[str, Any]) -> None:
    """Raise if a part of a document that is read is of another kind than it must be.

    Raises:
        ValueError: With its place, what is there and what was expected.
    """
    lengths = {
        name: len(found) for name, found in document.items() if isinstance(found, (list, tuple))
    }
    _check(document, _STRUCTURE, "", lengths)


def _check(value: Any, expected: Any, where: str, lengths: Mapping[str, int]) -> None:
    """Raise if a value is of another kind, or holds one that is."""
    if isinstance(expected, str):
        _check_index(value, expected, where, lengths.get(expected, 0))
        return
    kind, name = next(each for each in _KINDS if expected is each[0] or type(expected) is each[0])
    if not isinstance(value, kind) or isinstance(value, bool) or (kind is int and value < 0):
        raise _refusal(where, name, value)
    if isinstance(expected, dict):
        for key, each in value.items():
            inner = expected.get(key, expected.get("*"))
            # Some exporters write null for what there is not.
            if inner is not None and each is not None:
                _check(each, inner, f"{where}.{key}" if where else str(key), lengths)
    elif isinstance(expected, list):
        for index, each in enumerate(value):
            _check(each, expected[0], f"{where}.{index}", lengths)


def _check_index(value: Any, target: str, where: str, length: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < length:
        raise _refusal(where, f"an index, from 0, of one of the {length} {target}", value)


def _refusal(where: str, expected: str, value: Any) -> ValueError:
    return ValueError(f"{where} must be {expected}, not {quote(value)}")
