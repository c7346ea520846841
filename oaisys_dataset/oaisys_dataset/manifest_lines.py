"""The lines of a data set's manifests as sequences of records, read when they are asked for."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_dataset.places import StoragePlace
from oaisys_dataset.records import SensorRecord

READERS = 8
"""Manifests that are read at the same time, because a remote place takes long to answer."""

RecordT = TypeVar("RecordT", bound=SensorRecord)


class WorldManifest(NamedTuple):
    """Where the lines of a world's manifest are.

    Attributes:
        world: The world.
        split: Its split.
        ends: (N,) end of each line, in bytes.
    """

    world: int
    split: str
    ends: NDArray[np.int64]


def index_manifests(
    place: StoragePlace,
    worlds: Iterable[int],
    name_of: Callable[[int], str],
    parse: Callable[[bytes, str], RecordT],
) -> list[WorldManifest]:
    """Return where the lines of some worlds' manifests are.

    Args:
        place: The data set.
        worlds: The worlds, in order.
        name_of: Returns the name of a world's manifest.
        parse: Returns the record of a line, whose name it is given, too.

    Raises:
        InvalidInputError: A manifest cannot be read.
    """
    with ThreadPoolExecutor(READERS) as threads:
        return list(threads.map(partial(_index, place, name_of, parse), worlds))


class ManifestLines(Sequence[RecordT]):
    """The records in the manifests of some worlds, read when they are asked for.

    Only the manifest of one world is in memory at a time.
    """

    def __init__(
        self,
        place: StoragePlace,
        kind: type[RecordT],
        name_of: Callable[[int], str],
        manifests: Sequence[WorldManifest],
    ) -> None:
        """Keep where the records are.

        Args:
            place: The data set.
            kind: Of each record.
            name_of: Returns the name of a world's manifest.
            manifests: The manifests.
        """
        self._place = place
        self._kind = kind
        self._name_of = name_of
        self._manifests = manifests
        self._worlds = [manifest.world for manifest in manifests]
        self._firsts = np.cumsum([0, *(len(manifest.ends) for manifest in manifests)])
        self._held: tuple[int, bytes] | None = None

    def __len__(self) -> int:
        return int(self._firsts[-1])

    @overload
    def __getitem__(self, index: int) -> RecordT: ...
    @overload
    def __getitem__(self, index: slice) -> list[RecordT]: ...
    def __getitem__(self, index: int | slice) -> RecordT | list[RecordT]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        wanted = index + len(self) if index < 0 else index
        if not 0 <= wanted < len(self):
            raise IndexError(f"received {index}, there are {len(self)} records")
        number = int(np.searchsorted(self._firsts, wanted, side="right")) - 1
        return self._line(self._manifests[number], wanted - int(self._firsts[number]))

    def __iter__(self) -> Iterator[RecordT]:
        for world in self._worlds:
            yield from self.of_world(world)

    def has_world(self, world: int) -> bool:
        """Return whether there are records of a world."""
        return self._number(world) is not None

    def of_world(self, world: int) -> Iterator[RecordT]:
        """Return the records of a world, read one by one.

        Raises:
            NotFoundError: There are none.
        """
        manifest = self._manifest(world)
        return (self._line(manifest, line) for line in range(len(manifest.ends)))

    def last_of_world(self, world: int) -> RecordT:
        """Return the last record of a world.

        Raises:
            NotFoundError: There is none.
        """
        manifest = self._manifest(world)
        return self._line(manifest, len(manifest.ends) - 1)

    def _line(self, manifest: WorldManifest, line: int) -> RecordT:
        name = self._name_of(manifest.world)
        held = self._held
        if held is None or held[0] != manifest.world:
            held = self._held = (manifest.world, self._place.read(name))
        begin = int(manifest.ends[line - 1]) if line else 0
        text = held[1][begin : int(manifest.ends[line])]
        where = f"{name}:{line + 1}"
        record = self._kind.from_json(text, where)
        for field, received, expected in _contradictions(record, manifest):
            raise InvalidInputError(f"{where}: {field}", received, expected)
        return record

    def _manifest(self, world: int) -> WorldManifest:
        number = self._number(world)
        if number is None:
            raise NotFoundError(f"world {world}: not in {self._place.url}")
        return self._manifests[number]

    def _number(self, world: int) -> int | None:
        number = bisect_left(self._worlds, world)
        return number if self._worlds[number : number + 1] == [world] else None


def _contradictions(
    record: SensorRecord, manifest: WorldManifest
) -> Iterator[tuple[str, object, str]]:
    """Yield each field that contradicts others, or its manifest."""
    for field, expected in (("world", manifest.world), ("split", manifest.split)):
        received = getattr(record, field)
        if received != expected:
            yield field, received, f"{expected}, as this file and its first line say"
    yield from record.contradictions()


def _index(
    place: StoragePlace,
    name_of: Callable[[int], str],
    parse: Callable[[bytes, str], RecordT],
    world: int,
) -> WorldManifest:
    """Return where the lines of a manifest are."""
    name = name_of(world)
    text = place.read(name)
    ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n")) + 1
    if not len(ends) or ends[-1] != len(text):
        raise InvalidInputError("file", name, "lines, each with its end")
    return WorldManifest(world, parse(text[: ends[0]], f"{name}:1").split, ends)
