"""The state of an import: where files are, names of labels, and warnings."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.importing.stand_ins import StandIns
from oaisys_core.procedural.textures.folder import has_color_map

NO_LABEL = "unlabelled"


class ImportContext:
    """The state of one import: its files and their replacements, label names and warnings."""

    def __init__(
        self,
        assets: Path | None,
        out: Path | None,
        *,
        is_strict: bool,
        stand_ins: StandIns | None = None,
    ) -> None:
        """Look for files in ``assets``, write files beside ``out``, and make ``stand_ins``."""
        self._assets = assets
        self.out = out
        self._stand_ins = stand_ins
        self.missing: list[str] = []
        self._things: dict[int, dict[str, None]] = {}
        self._is_strict = is_strict
        self._names: dict[int, str] = {0: NO_LABEL}
        self.warnings: list[str] = []

    def warn(self, text: str) -> None:
        """Add a warning, unless there is the same one already."""
        if text not in self.warnings:
            self.warnings.append(text)

    def file(
        self, name: str, stand_in: str, make: Callable[[StandIns], Path] | None = None
    ) -> Path | None:
        """Return the file with a name, or None if it is missing.

        Args:
            name: Path in the original file.
            stand_in: Description of what replaces it.
            make: Makes a file that replaces it, if the user wants that.
        """
        found = None if self._assets is None else self._assets / name
        # os.path.isfile is False for names that are too long, where Path.is_file raises.
        if found is not None and os.path.isfile(found):  # noqa: PTH113
            return found.resolve()
        return self._replace(name, "is missing", stand_in, make)

    def material_folder(self, name: str, texture: str) -> Path | None:
        """Return the folder of a material's maps, or None if it is missing or has no colour map.

        Args:
            name: Path in the original file.
            texture: The built-in texture set that replaces it.
        """
        found = None if self._assets is None else self._assets / name
        is_there = found is not None and os.path.isdir(found)  # noqa: PTH112
        if found is not None and is_there and has_color_map(found):
            return found.resolve()
        fault = "has no colour map" if is_there else "is missing"
        words = f"the built-in texture {texture}"
        return self._replace(name, fault, words, lambda made: made.material(name, texture))

    def _replace(
        self, name: str, fault: str, stand_in: str, make: Callable[[StandIns], Path] | None
    ) -> Path | None:
        if self._is_strict:
            self.missing.append(f"{name} {fault}")
        if self._stand_ins is not None and make is not None and not self._is_strict:
            try:
                path = make(self._stand_ins)
            except (OSError, ValueError) as error:
                expected = f"a name that a file can have ({error})"
                raise InvalidInputError("--stand-ins", name, expected) from error
            self.warn(f"{name} {fault}: it is replaced by the generated {path}")
            return path
        self.warn(f"{name} {fault}: it is replaced by {stand_in}")
        return None

    def name_label(self, semantic_id: int, name: str, thing: str | None = None) -> str:
        """Return the preliminary name of an id: the first name that it was given.

        Args:
            semantic_id: The id.
            name: Name on its level.
            thing: The object that has the id; None if it is ``name``.
        """
        self._things.setdefault(semantic_id, {})[thing or name] = None
        return self._names.setdefault(semantic_id, name)

    def rename_shared(self, node: Any) -> None:
        """Rename ids that several objects share to a combination of their names."""
        if isinstance(node, list):
            for each in node:
                self.rename_shared(each)
        if not isinstance(node, dict):
            return
        things = self._things.get(node.get("semantic_id", 0), {})
        if "label" in node and node["semantic_id"] and len(things) > 1:
            node["label"] = self._name_for_all(node["semantic_id"])
        if node.get("sky_semantic_id"):
            node["sky_label"] = self._name_for_all(node["sky_semantic_id"])
        for each in node.values():
            self.rename_shared(each)

    def _name_for_all(self, semantic_id: int) -> str:
        things = list(self._things[semantic_id])
        if len(things) > 1:
            self.warn(f"the id {semantic_id} is shared by {', '.join(things)}")
        return " or ".join(things)

    def labels(self, ids: Sequence[int], name: str) -> dict[str, Any]:
        """Return the label, id and levels of an object."""
        named = [
            {
                "label": self.name_label(i, name if n == 0 else f"{name}_{n}", name),
                "semantic_id": i,
            }
            for n, i in enumerate(ids)
        ]
        if not named:
            named = [{"label": NO_LABEL, "semantic_id": 0}]
        return {**named[0], "levels": named[1:]} if named[1:] else named[0]

    def mapping(
        self, entry: dict[str, Any], level: int, ids: list[int], name: str
    ) -> dict[str, Any]:
        """Return the labels by colour of a label image for one level of ``ids``."""
        found = {}
        for key, (color, entry_ids) in entry.get("mappingTable", {}).items():
            of_entry = [*ids[:level], int(entry_ids[0]), *ids[level + 1 :]]
            labels = [
                {"label": self.name_label(i, f"{name}_{key}", name), "semantic_id": i}
                for i in of_entry
            ]
            code = "#" + "".join(f"{int(value):02x}" for value in color)
            found[code] = {**labels[0], **({"levels": labels[1:]} if labels[1:] else {})}
        return found
