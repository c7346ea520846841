"""Whether data sets can become one: equal sensors, equal meaning of labels, different worlds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from oaisys_core.errors import InvalidInputError
from oaisys_dataset.manifest import DatasetInfo, FrameRecord
from oaisys_dataset.reader import Dataset
from oaisys_dataset.shards import HEAD

NOT_OF_THE_WORLD = ("backend", "render", "seed", "sensors")
"""Sections of a configuration that do not change what a world of a given seed is."""


@dataclass
class _Layout:
    """What a data set holds.

    Attributes:
        name: Where it is.
        sensors: What each sensor measures, by the sensor's name: a word for each property.
        labels: Labels by id.
        worlds: Number of each world by its `worlds_sha256` and seed.
        frames: Id of each frame by the hash of its pixels.
    """

    name: str
    sensors: dict[str, dict[str, object]] = field(default_factory=dict)
    labels: dict[int, str] = field(default_factory=dict)
    worlds: dict[tuple[str, int], int] = field(default_factory=dict)
    frames: dict[bytes, str] = field(default_factory=dict)


def worlds_sha256(info: DatasetInfo) -> str:
    """Return the hash of what a data set's worlds are drawn from, but for their seeds.

    Worlds are the same if, and only if, this hash and their seeds are equal.
    """
    kept = {name: part for name, part in info.config.items() if name not in NOT_OF_THE_WORLD}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()


def check_can_be_merged(datasets: Sequence[Dataset]) -> None:
    """Raise unless data sets have the same sensors and labels, and no world in common.

    Raises:
        InvalidInputError: Two of them differ, or are the same in part; says in what. Or a
            configuration is not the one that its worlds were rendered with.
    """
    layouts: list[_Layout] = []
    for dataset in datasets:
        _check_complete(dataset)
        dataset.info.check_configs(f"{dataset.place.url}: {HEAD}")
        layout = _layout(dataset)
        for earlier in layouts:
            _check_sensors(earlier, layout)
            _check_labels(earlier, layout)
            _check_worlds(earlier, layout)
            _check_frames(earlier, layout)
        layouts.append(layout)


def _check_complete(dataset: Dataset) -> None:
    """Raise if worlds of a data set are neither finished nor failed."""
    done = {*dataset.worlds, *(failure.world for failure in dataset.failures)}
    missing = sorted(set(range(dataset.info.worlds)) - done)
    if missing:
        expected = f"all {dataset.info.worlds} worlds finished or failed (render --resume)"
        received = f"{len(missing)} missing worlds, such as {missing[0]}"
        raise InvalidInputError(f"{dataset.place.url}: worlds", received, expected)
    beyond = sorted(done - set(range(dataset.info.worlds)))
    if beyond:
        expected = f"worlds from 0 to {dataset.info.worlds - 1}, as dataset.json says"
        raise InvalidInputError(f"{dataset.place.url}: worlds", beyond[0], expected)


def _layout(dataset: Dataset) -> _Layout:
    layout = _Layout(dataset.place.url)
    modalities: dict[str, set[str]] = {}
    drawn_from = {part.first_world: worlds_sha256(part.info) for part in dataset.info.parts}
    for record in dataset.records:
        camera = record.camera
        modalities.setdefault(record.sensor, set()).update(record.images)
        layout.sensors[record.sensor] = {
            "size": f"{camera.width_px}x{camera.height_px}",
            "lens": "fisheye" if camera.is_fisheye else "perspective",
        }
        part = dataset.info.part_of(record.world)
        if record.config_sha256 != part.info.config_sha256:
            where = f"{dataset.place.url}: {record.frame_id}: config_sha256"
            raise InvalidInputError(
                where, record.config_sha256, f"{part.info.config_sha256}, as of {HEAD}"
            )
        first_world = part.first_world
        layout.worlds[drawn_from[first_world], record.world_seed] = record.world
        layout.frames[_pixels_digest(record)] = record.frame_id
    for sensor, names in modalities.items():
        layout.sensors[sensor]["modalities"] = ", ".join(sorted(names))
    for scan in dataset.scans:
        layout.sensors[scan.sensor] = {"fields": ", ".join(scan.points.fields)}
    for world in dataset.worlds:
        for label_id, label in dataset.legend(world).labels.items():
            if layout.labels.setdefault(label_id, label) != label:
                text = f"{label!r} in world {world}"
                expected = f"{layout.labels[label_id]!r}, as in its worlds before"
                raise InvalidInputError(f"{layout.name}: label {label_id}", text, expected)
    return layout


def _check_sensors(earlier: _Layout, now: _Layout) -> None:
    names, wanted_names = (", ".join(sorted(each.sensors)) for each in (now, earlier))
    _check_equal(f"{now.name}: sensors", names, earlier, wanted_names)
    for sensor, properties in now.sensors.items():
        for name, value in properties.items():
            wanted = earlier.sensors[sensor].get(name)
            _check_equal(f"{now.name}: {name} of {sensor}", value, earlier, wanted)


def _check_equal(what: str, received: object, earlier: _Layout, wanted: object) -> None:
    if received != wanted:
        raise InvalidInputError(what, received, f"{wanted}, as in {earlier.name}")


def _check_labels(earlier: _Layout, now: _Layout) -> None:
    """Raise if an id means two labels, or a label has other ids."""
    for label_id, label in now.labels.items():
        wanted = earlier.labels.get(label_id, label)
        _check_equal(f"{now.name}: label {label_id}", repr(label), earlier, repr(wanted))
    ids_now, ids_before = _ids_of(now.labels), _ids_of(earlier.labels)
    for label in ids_now.keys() & ids_before.keys():
        if not ids_now[label] & ids_before[label]:
            first = min(ids_before[label])
            _check_equal(f"{now.name}: id of {label!r}", min(ids_now[label]), earlier, first)


def _ids_of(labels: Mapping[int, str]) -> dict[str, set[int]]:
    ids: dict[str, set[int]] = {}
    for label_id, label in labels.items():
        ids.setdefault(label, set()).add(label_id)
    return ids


def _check_worlds(earlier: _Layout, now: _Layout) -> None:
    """Raise if both have a world, which would be in the merged set twice."""
    for key, world in now.worlds.items():
        if key in earlier.worlds:
            expected = (
                f"other worlds than those of {earlier.name}: it is its world"
                f" {earlier.worlds[key]}, of the same seed {key[1]}"
            )
            raise InvalidInputError(f"{now.name}: world", world, expected)


def _check_frames(earlier: _Layout, now: _Layout) -> None:
    """Raise if both have a frame: worlds of other configurations may have drawn the same."""
    both = now.frames.keys() & earlier.frames.keys()
    if both:
        frame, first = min((now.frames[each], earlier.frames[each]) for each in both)
        expected = f"other images than those of {first} in {earlier.name}"
        raise InvalidInputError(f"{now.name}: frame", frame, expected)


def _pixels_digest(record: FrameRecord) -> bytes:
    """Return a hash of all pixels of a frame."""
    images = sorted((name, image.pixels_sha256) for name, image in record.images.items())
    return hashlib.sha256(repr(images).encode()).digest()
