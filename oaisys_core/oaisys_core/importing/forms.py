"""Forms of the values in an original configuration file; the table is in ``forms.yaml``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from fnmatch import fnmatchcase
from functools import cache, partial
from pathlib import Path
from typing import Any

import yaml

from oaisys_core.errors import InvalidInputError
from oaisys_core.importing.document import Json

LARGEST = 1e30
"""Numbers up to this can be multiplied with each other without an overflow."""

TEXTURE = "ASSET_SETUP.MATERIALS.materialParams.terrainTextureList"
"""Path of the keys of a texture."""

LISTS: dict[str, tuple[str, ...]] = {
    "RENDER_SETUP.RENDER_PASSES": (),
    "RENDER_POST_PROCESSING_EFFECTS_SETUP.POST_EFFECTS": ("BloomEffect",),
    "SENSOR_SETUP.SENSORS": ("SensorCameraRGBD",),
    "ENVIRONMENT_EFFECTS_SETUP.ENVIRONMENT_EFFECTS": ("EnvLightBlenderSky", "EnvHDRI"),
    "ENVIRONMENT_EFFECTS_SETUP.ENVIRONMENT_EFFECTS.environmentEffectsParams.HDRIList": (),
    "ASSET_SETUP.MATERIALS": (),
    f"{TEXTURE}*": (),
    "ASSET_SETUP.STAGES": (),
    "ASSET_SETUP.MESHES": ("MeshMultipleRandom", "MeshAsteroid"),
}
"""Paths of lists of objects, with the types that are read, if not all; others are left out."""

Check = Callable[[Any], bool]


def _is_number(value: Any, least: float = -LARGEST, most: float = LARGEST) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and least <= value <= most


def _is_whole(value: Any, least: float = -LARGEST, most: float = LARGEST) -> bool:
    return _is_number(value, least, most) and value == int(value)


def _is_id(value: Any) -> bool:
    return _is_whole(value, least=0)


def _is_list(of: Check, least: int, most: int, value: Any) -> bool:
    return isinstance(value, list) and least <= len(value) <= most and all(map(of, value))


def _is_span(value: Any) -> bool:
    return _is_number(value) or _is_list(_is_number, 1, 2, value)


def _is_label(value: Any) -> bool:
    """Return whether a value is an id, or the ids by colour of a label image."""
    if not isinstance(value, Mapping):
        return _is_id(value)
    table = value.get("mappingTable", {})
    if not isinstance(value.get("filePath", ""), str) or not isinstance(table, Mapping):
        return False
    return all(map(_is_color_and_ids, table.values()))


def _is_color_and_ids(value: Any) -> bool:
    if not _is_list(_are_ids, 2, 2, value):
        return False
    color, ids = value
    return _is_list(partial(_is_whole, least=0, most=255), 3, 3, color) and ids != []


_MANY = 1_000_000
_are_labels = partial(_is_list, _is_label, 0, _MANY)
_are_pairs = partial(_is_list, partial(_is_list, _is_number, 2, 2), 0, _MANY)
_are_ids = partial(_is_list, _is_id, 0, _MANY)

CHECKS: dict[str, Check] = {
    "anything": lambda _: True,
    "a text": lambda value: isinstance(value, str),
    "a text or null": lambda value: value is None or isinstance(value, str),
    "a text, or 3 numbers": lambda value: (
        isinstance(value, str) or _is_list(_is_number, 3, 3, value)
    ),
    "true or false": lambda value: isinstance(value, bool) or value in (0, 1),
    "a number": _is_number,
    "a number other than 0": lambda value: _is_number(value) and value != 0,
    "a number from -100 to 100": partial(_is_number, least=-100, most=100),
    "a number, or a list of one or two": _is_span,
    "a whole number": _is_whole,
    "2 whole numbers": partial(_is_list, _is_whole, 2, 2),
    "3 numbers": partial(_is_list, _is_number, 3, 3),
    "6 numbers": partial(_is_list, _is_number, 6, 6),
    "7 numbers": partial(_is_list, _is_number, 7, 7),
    "9 numbers": partial(_is_list, _is_number, 9, 9),
    "3 or 4 numbers": partial(_is_list, _is_number, 3, 4),
    "1 to 4 numbers": partial(_is_list, _is_number, 1, 4),
    "a list that begins with a number, or with a list of one or two": lambda value: (
        isinstance(value, list) and value != [] and _is_span(value[0])
    ),
    "a list of pairs of numbers": _are_pairs,
    "a list of whole numbers from 0": _are_ids,
    "a list of lists of whole numbers from 0": partial(_is_list, _are_ids, 0, _MANY),
    "a list of labels": _are_labels,
    "a list of lists of labels": partial(_is_list, _are_labels, 0, _MANY),
}
"""Whether a value has a form, by its words in errors."""

_LABELS = (
    "; a label is a whole number from 0, or"
    " {filePath: TEXT, mappingTable: {NAME: [[RED, GREEN, BLUE], [ID]]}}"
)


def check_forms(document: Json, at: str = "", shown: str = "") -> None:
    """Raise if a value that is read has another form than its key is for.

    Args:
        document: An original configuration, or a part of it.
        at: Its path, without indices of lists.
        shown: Its path in errors.

    Raises:
        InvalidInputError: It names the key's path, the value and what was expected.
    """
    for key, value in document.items():
        path, name = f"{at}.{key}".removeprefix("."), f"{shown}.{key}".removeprefix(".")
        form = form_of(path)
        if form is not None and not CHECKS[form](value):
            raise InvalidInputError(name, value, form + (_LABELS if "labels" in form else ""))
        if form is None and any(_matches(path, parent) for parent in _parents()):
            for each, place in _objects(value, path, name):
                check_forms(each, path, place)


def form_of(path: str) -> str | None:
    """Return the words of the form at a path without indices; None if nothing reads it."""
    return next((form for pattern, form in _forms() if _matches(path, pattern)), None)


def _objects(value: Any, path: str, name: str) -> Iterator[tuple[Json, str]]:
    """Yield the objects at a path, and their paths in errors."""
    if value in (None, [], {}):
        return
    kinds = next((kinds for pattern, kinds in LISTS.items() if _matches(path, pattern)), None)
    if kinds is None:
        if not isinstance(value, dict):
            raise InvalidInputError(name, value, "an object")
        yield value, name
        return
    if not isinstance(value, list):
        raise InvalidInputError(name, value, "a list of objects")
    for index, each in enumerate(value):
        place = f"{name}[{index}]"
        if not isinstance(each, dict):
            raise InvalidInputError(place, each, "an object")
        kind = each.get("type")
        if kinds and isinstance(kind, str) and kind not in kinds:
            continue
        yield each, place


def _matches(path: str, pattern: str) -> bool:
    return path.count(".") == pattern.count(".") and fnmatchcase(path, pattern)


@cache
def _forms() -> tuple[tuple[str, str], ...]:
    """Return each pattern of a path, and the form of its values."""
    table = yaml.safe_load(Path(__file__).with_name("forms.yaml").read_text(encoding="utf-8"))
    return tuple(
        (f"{section}.{name}", form)
        for section, forms in table.items()
        for form, names in forms.items()
        for name in names
    )


@cache
def _parents() -> frozenset[str]:
    """Return the patterns of paths of objects, and of lists of them, that hold values."""
    parts = [pattern.split(".") for pattern, _ in _forms()]
    return frozenset(".".join(names[:end]) for names in parts for end in range(1, len(names)))
