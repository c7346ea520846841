"""What all parts of an import share: files, names of labels, and what is told to the user."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from oaisys_core.errors import ConfigError

NO_LABEL = "unlabelled"


class Import:
    """One import: where files are found, what they are replaced by, and what labels are called."""

    def __init__(self, assets: Path | None, out: Path | None, *, is_strict: bool) -> None:
        """Take files from ``assets``; write others beside ``out``."""
        self._assets = assets
        self.out = out
        self._is_strict = is_strict
        self._names: dict[int, str] = {0: NO_LABEL}
        self.warnings: list[str] = []

    def warn(self, text: str) -> None:
        """Tell the user something, once."""
        if text not in self.warnings:
            self.warnings.append(text)

    def file(self, name: str, stand_in: str, *, is_folder: bool = False) -> Path | None:
        """Return the file of a name, None where it is missing.

        Args:
            name: As the original file has it.
            stand_in: What is used in its place.
            is_folder: Whether it is a folder.

        Raises:
            ConfigError: It is missing, and the import is strict.
        """
        found = Path(name) if self._assets is None else self._assets / name
        if self._assets is not None and (found.is_dir() if is_folder else found.is_file()):
            return found.resolve()
        if self._is_strict:
            raise ConfigError(f"{name}: received no such file below --assets, expected it there")
        self.warn(f"{name} is missing: {stand_in} stands in for it")
        return None

    def name_label(self, semantic_id: int, name: str) -> str:
        """Return what an id is called: the first name that it was given."""
        return self._names.setdefault(semantic_id, name)

    def labels(self, ids: Sequence[int], name: str) -> dict[str, Any]:
        """Return label, id and levels of a thing."""
        named = [
            {"label": self.name_label(i, name if n == 0 else f"{name}_{n}"), "semantic_id": i}
            for n, i in enumerate(ids)
        ]
        if not named:
            named = [{"label": NO_LABEL, "semantic_id": 0}]
        return {**named[0], "levels": named[1:]} if named[1:] else named[0]

    def mapping(
        self, entry: dict[str, Any], level: int, ids: list[int], name: str
    ) -> dict[str, Any]:
        """Return the labels by colour of a label image that stands at a level of ``ids``."""
        found = {}
        for key, (color, told) in entry.get("mappingTable", {}).items():
            of_entry = [*ids[:level], int(told[0]), *ids[level + 1 :]]
            labels = [
                {"label": self.name_label(i, f"{name}_{key}"), "semantic_id": i} for i in of_entry
            ]
            code = "#" + "".join(f"{int(value):02x}" for value in color)
            found[code] = {**labels[0], **({"levels": labels[1:]} if labels[1:] else {})}
        return found
