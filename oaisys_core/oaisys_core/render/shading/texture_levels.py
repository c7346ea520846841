"""Levels of detail of texture sets, computed once and shared by all that look textures up."""

from __future__ import annotations

from collections.abc import Collection

from oaisys_core.procedural.textures.borders import Heights, height_levels
from oaisys_core.procedural.textures.levels import levels_of
from oaisys_core.scene import PbrMaps


class LevelStore:
    """Levels of detail of texture sets, and their heights; each set's at its first use."""

    def __init__(self) -> None:
        self._levels: dict[int, tuple[PbrMaps, ...]] = {}
        self._heights: dict[int, Heights] = {}

    def levels(self, maps: PbrMaps) -> tuple[PbrMaps, ...]:
        """Return the levels of detail of a texture set, finest first, see `levels_of`."""
        if id(maps) not in self._levels:
            levels = self._levels[id(maps)] = levels_of(maps)
            self._heights.update(zip(map(id, levels), height_levels(levels), strict=True))
        return self._levels[id(maps)]

    def heights(self, maps: PbrMaps) -> Heights:
        """Return the heights of a level by which borders follow its relief."""
        return self._heights[id(maps)]

    def keep_levels(self, used: Collection[int]) -> None:
        """Drop the levels of texture sets none of whose levels has an identity in ``used``."""
        for key, levels in list(self._levels.items()):
            if not any(id(level) in used for level in levels):
                del self._levels[key]
                for level in levels:
                    del self._heights[id(level)]
