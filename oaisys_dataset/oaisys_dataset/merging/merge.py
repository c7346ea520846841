"""Merges data sets: the worlds of all, one set after the other, in a set of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.files.whole_files import whole_folder
from oaisys_dataset.manifest import DatasetInfo, MergedSet
from oaisys_dataset.merging.layout import check_can_be_merged
from oaisys_dataset.merging.renumber import copy_world
from oaisys_dataset.places import StoragePlace, open_place
from oaisys_dataset.reader import Dataset, open_dataset
from oaisys_dataset.shards import HEAD, write_failure


class MergedWorlds(NamedTuple):
    """Where the worlds of a data set are in a merged one.

    Attributes:
        place: The data set.
        worlds: Number of its worlds.
        first_world: Number that its world 0 has in the merged set; its other worlds follow.
        failed: Number of its worlds that could not be made; they are so in the merged set, too.
    """

    place: str
    worlds: int
    first_world: int
    failed: int


def merge_datasets(
    sources: Sequence[str | Path],
    target: str | Path,
    on_world: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[MergedWorlds]:
    """Write a data set that has all worlds of several data sets.

    Worlds keep their splits, seeds and all that was recorded of them; those of the second and the
    following sets get new numbers, and with them new ids of frames and scans. A folder appears when
    everything is written; at a URL, ``dataset.json`` is written last.

    Args:
        sources: Folders or URLs of at least two data sets.
        target: A folder or URL with nothing in it.
        on_world: Receives the number of worlds that are written, and how many there are to write.

    Raises:
        InvalidInputError: The sets differ in sensors, modalities or labels, have a world in common,
            are not finished, or were changed after they had been written.
        RenderError: The set could not be written; nothing is left.
    """
    if len(sources) < 2:
        raise InvalidInputError("datasets", ", ".join(map(str, sources)), "at least two data sets")
    place = open_place(target)
    if not place.is_empty():
        raise InvalidInputError("out", place.url, "a folder that does not exist or is empty")
    datasets = [open_dataset(source) for source in sources]
    check_can_be_merged(datasets)
    firsts = [0, *accumulate(dataset.info.worlds for dataset in datasets)]
    total, done = sum(len(dataset.worlds) for dataset in datasets), 0
    with _write_whole(place) as part:
        for dataset, first in zip(datasets, firsts, strict=False):
            for world in dataset.worlds:
                copy_world(dataset, world, part, first + world)
                done += 1
                on_world(done, total)
            for failure in dataset.failures:
                write_failure(part, replace(failure, world=first + failure.world))
        part.write(HEAD, merge_heads(datasets).to_json().encode())
    return [
        MergedWorlds(each.place.url, each.info.worlds, first, len(each.failures))
        for each, first in zip(datasets, firsts, strict=False)
    ]


def merge_heads(datasets: Sequence[Dataset]) -> DatasetInfo:
    """Return the head of the set that has the worlds of several ones, in their order."""
    merged: list[MergedSet] = []
    first = 0
    for dataset in datasets:
        merged += _merged_sets(dataset, first)
        first += dataset.info.worlds
    infos = [dataset.info for dataset in datasets]
    names = dict.fromkeys(name for info in infos for name in info.splits)
    planned = {
        name: sum(Fraction(info.splits.get(name, 0.0)) * info.worlds for info in infos)
        for name in names
    }
    return replace(
        infos[0],
        worlds=first,
        views=max(info.views for info in infos),
        splits={name: float(worlds / first) for name, worlds in planned.items()},
        options={},
        merged=tuple(merged),
    )


def _merged_sets(dataset: Dataset, first: int) -> Iterator[MergedSet]:
    """Yield the parts of a data set whose first world gets a number."""
    of_place = dataset.info.merged
    for number, part in enumerate(dataset.info.parts):
        info = part.info
        yield MergedSet(
            place=of_place[number].place if of_place else dataset.place.url,
            first_world=first + part.first_world,
            config=info.config,
            config_sha256=info.config_sha256,
            seed=info.seed,
            worlds=info.worlds,
            views=info.views,
            splits=info.splits,
            software=info.software,
        )


@contextmanager
def _write_whole(place: StoragePlace) -> Iterator[StoragePlace]:
    """Yield a place for a data set that is there when the block succeeds, or not at all."""
    if place.folder is not None:
        try:
            with whole_folder(place.folder) as folder:
                yield open_place(folder)
        except OSError as error:
            text = error.strerror or error
            raise RenderError(f"{place.url}: could not be written: {text}") from error
        return
    try:
        yield place
    except BaseException:
        place.clear()
        raise
