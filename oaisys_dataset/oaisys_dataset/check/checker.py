"""The check of a whole data set."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from pathlib import Path

import numpy as np

from oaisys_core.errors import OaisysError
from oaisys_core.verification.audit import sum_results
from oaisys_dataset.check.head import PlannedPart, part_plans, world_faults, world_plans
from oaisys_dataset.check.report import MAX_FINDINGS, CheckReport, DatasetFinding, ShardResult
from oaisys_dataset.check.shard import check_shard
from oaisys_dataset.check.truth import TruthCheck, TruthResult
from oaisys_dataset.manifest import DatasetInfo
from oaisys_dataset.places import StoragePlace, open_place
from oaisys_dataset.plan import WorldTask
from oaisys_dataset.reader import Dataset, open_dataset
from oaisys_dataset.shards import (
    HEAD,
    manifest_name,
    read_head,
    whole_worlds,
    world_failures,
)


def check_dataset(
    where: str | Path,
    worlds_rebuilt: int = 1,
    seed: int = 0,
    on_world: Callable[[int, int], None] = lambda _done, _total: None,
) -> CheckReport:
    """Check every file of a data set, and the images of some worlds against the worlds themselves.

    Args:
        where: Its folder or URL.
        worlds_rebuilt: Number of worlds, drawn at random, that are made again.
        seed: Draws the worlds, views and pixels that are compared.
        on_world: Receives the number of worlds that are done, and how many there are to do.

    Raises:
        InvalidInputError: There is no data set, or its head cannot be read.
    """
    place = open_place(where)
    info = read_head(place)
    worlds = whole_worlds(place)
    rng = np.random.default_rng(seed)
    summary = _Summary(place, info)
    part_of = summary.check_head()
    total = len(worlds) + min(worlds_rebuilt, len(worlds))
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        shards = threads.map(lambda world: check_shard(place, part_of(world), world), worlds)
        for done, shard in enumerate(shards, start=1):
            summary.add(shard)
            on_world(done, total)
    chosen = _choose(summary.sound_worlds, worlds_rebuilt, rng)
    summary.rebuild(where, chosen, rng, lambda done: on_world(len(worlds) + done, total))
    return summary.report()


class _Summary:
    """Collects what is found, and compares the worlds with one another."""

    def __init__(self, place: StoragePlace, info: DatasetInfo) -> None:
        self._place = place
        self._info = info
        self._findings: list[DatasetFinding] = []
        self._findings_total = 0
        self._counts: Counter[str] = Counter()
        self._splits: dict[int, str] = {}
        self._planned: dict[int, WorldTask] = {}
        self._part_of: Callable[[int], PlannedPart]
        self._world_of_seed: dict[tuple[str, int], int] = {}
        self._frame_of_print: dict[bytes, str] = {}
        self._rebuilt: list[int] = []
        self._truth = TruthResult()
        self._notes: list[str] = []
        self.sound_worlds: list[int] = []

    def check_head(self) -> Callable[[int], PlannedPart]:
        """Check the head, and that each planned world is finished or has failed.

        Returns:
            The part of the data set that a world is in.
        """
        parts, findings = part_plans(self._info)
        self._note_found(findings)
        self._planned = world_plans(parts)
        self._note_found(world_faults(self._place, self._info))
        firsts = [part.first_world for part in parts]
        self._part_of = lambda world: parts[bisect_right(firsts, world) - 1]
        return self._part_of

    def add(self, shard: ShardResult) -> None:
        """Add the result of a world."""
        self._note_found(shard.findings)
        self._counts["worlds"] += 1
        self._counts["frames"] += shard.records
        self._counts["images"] += shard.images
        self._counts["scans"] += shard.scans
        self._counts["image_bytes"] += shard.image_bytes
        if shard.splits:
            self._splits[shard.world] = min(shard.splits)
        self._check_plan(shard)
        for seed in shard.seeds:
            self._check_seed(seed, shard.world)
        for frame, pixels in shard.prints.items():
            first = self._frame_of_print.setdefault(pixels, frame)
            if first != frame:
                text = f"all its images equal those of {first}"
                self._note_found([DatasetFinding("duplicate", frame, text)])
        if not any(f.check in ("manifest", "shard", "image") for f in shard.findings):
            self.sound_worlds.append(shard.world)

    def _check_plan(self, shard: ShardResult) -> None:
        """Check that a world that has the seed of the plan has its split, too."""
        planned = self._planned.get(shard.world)
        if planned is None or shard.seeds != {planned.seed} or len(shard.splits) != 1:
            return
        if shard.splits != {planned.split}:
            text = f"{min(shard.splits)!r}, expected {planned.split!r} as planned for its number"
            self._note_found([DatasetFinding("split", manifest_name(shard.world), text)])

    def rebuild(
        self,
        where: str | Path,
        worlds: Sequence[int],
        rng: np.random.Generator,
        on_world: Callable[[int], None],
    ) -> None:
        """Compare the frames of some worlds with the worlds themselves."""
        if not worlds:
            return
        try:
            dataset = open_dataset(where)
        except OaisysError as error:
            self._note_cannot_rebuild(error)
            return
        done = 0
        for part, of_part in groupby(worlds, key=self._part_of):
            try:
                truth = TruthCheck(part.info, rng)
            except OaisysError as error:
                self._note_cannot_rebuild(error)
                continue
            try:
                for world in of_part:
                    self._compare(truth, dataset, world)
                    done += 1
                    on_world(done)
            finally:
                truth.close()
            self._notes += [note for note in truth.notes if note not in self._notes]

    def _note_cannot_rebuild(self, error: OaisysError) -> None:
        self._note_found(
            [DatasetFinding("head", HEAD, f"its worlds cannot be made again: {error}")]
        )

    def report(self) -> CheckReport:
        """Return the report."""
        return CheckReport(
            place=self._place.url,
            worlds=self._counts["worlds"],
            frames=self._counts["frames"],
            images=self._counts["images"],
            image_bytes=self._counts["image_bytes"],
            failed_worlds=tuple(world_failures(self._place)),
            splits=dict(Counter(self._splits.values())),
            rebuilt_worlds=tuple(self._rebuilt),
            points=self._truth.points,
            audited=tuple(sum_results(self._truth.audited)),
            notes=tuple(self._notes),
            findings=tuple(self._findings),
            findings_total=self._findings_total,
            scans=self._counts["scans"],
            scan_points=self._truth.scan_points,
        )

    def _compare(self, truth: TruthCheck, dataset: Dataset, world: int) -> None:
        try:
            found = truth.check(dataset, world)
        except OaisysError as error:
            text = f"it cannot be made again: {error}"
            self._note_found([DatasetFinding("surface", f"world {world}", text)])
            return
        self._rebuilt.append(world)
        self._note_found(found.findings)
        self._truth.points += found.points
        self._truth.scan_points += found.scan_points
        self._truth.audited += found.audited

    def _check_seed(self, seed: int, world: int) -> None:
        key = self._part_of(world).drawn_from, seed
        first = self._world_of_seed.setdefault(key, world)
        if first != world:
            splits = f"{self._splits.get(first)} and {self._splits.get(world)}"
            text = f"it is the same world as {first}: both have the seed {seed} ({splits})"
            self._note_found([DatasetFinding("split", f"world {world}", text)])

    def _note_found(self, findings: Iterable[DatasetFinding]) -> None:
        for finding in findings:
            self._findings_total += 1
            if len(self._findings) < MAX_FINDINGS:
                self._findings.append(finding)


def _choose(worlds: Sequence[int], count: int, rng: np.random.Generator) -> list[int]:
    if not worlds:
        return []
    chosen = rng.choice(len(worlds), min(count, len(worlds)), replace=False)
    return sorted(worlds[number] for number in chosen.tolist())
