"""Records of a data set: what it is, each of its frames, the legend of a world; to JSON and back.

A *frame* is what one camera shows at one view of a world, in all modalities.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from itertools import accumulate
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import Field

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.canonical_json import canonical_text, text_sha256
from oaisys_core.output.record_types import (
    CameraFields,
    Count,
    Degrees,
    InstanceId,
    Label,
    LabelId,
    Matrix,
    Name,
    Number,
    Ordinal,
    PoseFields,
    ProvenanceFields,
    Seconds,
    Seed,
    Sha256,
    Shape,
    Share,
    SplitName,
    Text,
    fields_of,
)
from oaisys_core.output.records import intrinsics_from_record
from oaisys_core.types import PinholeIntrinsics
from oaisys_dataset.records import FileRecord, Record, SensorRecord

FORMAT_VERSION = 1
"""Version of the files; readers refuse later ones."""


@dataclass(frozen=True)
class ImageRecord(FileRecord):
    """An image file in a shard.

    Attributes:
        pixels_sha256: Hash of the array's bytes, little-endian, row by row.
        dtype, shape: Of the array, such as ``uint8`` and (480, 640, 3).
    """

    pixels_sha256: Sha256
    dtype: Annotated[Label, Field(max_length=32)]
    shape: Shape


@dataclass(frozen=True)
class FrameRecord(SensorRecord):
    """A line of the manifest: what a frame shows, and how to render it again.

    Attributes:
        frame_id: Names it in the data set: ``000012_0003_camera`` is world, view and sensor.
        world, view: Counted from 0; the simulation's batch and sample are each one more.
        split: ``train``, ``val``, ``test`` or another name; that of its world.
        world_seed: Seed that the world was drawn from.
        metadata: What the world and the view were given beyond the configuration; ``drawn`` is what
            was drawn of it for this world, by path.
        T_map_camera: 4x4 pose of the camera's optical frame (x right, y down, z forward) in
            ``map``.
        intrinsics: The camera, as `oaisys_core.output.records.intrinsics_record` writes it.
        stamp_s: Simulated time of the view since its world began.
        images: Its images by modality.
        provenance: See `oaisys_core.types.Provenance`.
        rig_pose: ``position_m`` and ``quat_xyzw`` of the rig in ``map``.
        worker: Who rendered it.
        seconds: Wall-clock time of its view, shared among the view's frames and lidar scans. The
            first view includes the making of its world, so the sum over all frames and scans is
            what workers took.
        software: Versions by name.
        label_pixels: Number of pixels by id in ``semantic_0``.
        sun_elevation_deg, sun_azimuth_deg: Where the sun is in ``map``; the azimuth is counted from
            x towards y. None if it is not known.
    """

    id_field: ClassVar[str] = "frame_id"
    pose_field: ClassVar[str] = "T_map_camera"

    frame_id: Name
    world: Ordinal
    view: Ordinal
    sensor: Name
    split: SplitName
    world_seed: Seed
    config_sha256: Sha256
    metadata: Mapping[str, Any]
    T_map_camera: Matrix
    intrinsics: CameraFields
    stamp_s: Seconds
    images: Annotated[Mapping[Name, ImageRecord], Field(min_length=1)]
    provenance: ProvenanceFields
    rig_pose: PoseFields
    worker: Label
    seconds: Seconds
    software: Mapping[Label, Label]
    label_pixels: Mapping[LabelId, Number] = field(default_factory=dict)
    sun_elevation_deg: Degrees | None = None
    sun_azimuth_deg: Degrees | None = None

    @property
    def camera(self) -> PinholeIntrinsics:
        """The camera."""
        return intrinsics_from_record(self.intrinsics)

    @property
    def modalities(self) -> Iterable[str]:
        """The modalities of its images."""
        return self.images

    def contradictions(self) -> Iterator[tuple[str, object, str]]:
        """Yield each field that contradicts others: its name, its value, what was expected."""
        yield from super().contradictions()
        camera = self.camera
        if not np.array_equal(camera.K, self.intrinsics["K"]):
            expected = f"{camera.K.tolist()}, after its focal lengths and principal point"
            yield "intrinsics.K", self.intrinsics["K"], expected
        size = (camera.height_px, camera.width_px)
        for modality, image in self.images.items():
            if image.shape[:2] != size:
                yield f"images.{modality}.shape", image.shape, f"{size}, the size of its camera"


@dataclass(frozen=True)
class LegendInstance:
    """An object of a world.

    Attributes:
        name: Its unique name.
        label, semantic_id: Its class on level 0.
        kind, group: See `oaisys_core.types.SceneObject`.
    """

    name: Label
    label: Label
    semantic_id: LabelId
    kind: Label = ""
    group: Label = ""


@dataclass(frozen=True)
class WorldLegend(Record):
    """What the ids in the label images of a world mean.

    Attributes:
        labels: Label by semantic id, on all levels; 0, no label, is not among them.
        instances: Objects by instance id.
    """

    has_hash: ClassVar[bool] = True

    labels: Mapping[LabelId, Label]
    instances: Mapping[InstanceId, LegendInstance]

    def _data(self) -> dict[str, Any]:
        return {name: dict(sorted(by_id.items())) for name, by_id in super()._data().items()}


@dataclass(frozen=True)
class WorldFailure(Record):
    """A world that could not be made.

    Attributes:
        world: Its index.
        split: The split that it would have been in.
        world_seed: Seed that it was drawn from.
        reason: The error.
        attempts: How often it was tried.
    """

    world: Ordinal
    split: SplitName
    world_seed: Seed
    reason: Text
    attempts: Number = 1


@dataclass(frozen=True)
class _ConfigFields:
    """What readers use of a configuration, which may be that of another version."""

    sensors: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MergedSet:
    """A data set whose worlds are in a merged one.

    Attributes:
        place: Where it was.
        first_world: Number that its world 0 has now; its other worlds follow.
        config, config_sha256, seed, worlds, views, splits, software: See `DatasetInfo`.
    """

    place: Label
    first_world: Ordinal
    config: Annotated[Mapping[str, Any], fields_of(_ConfigFields)]
    config_sha256: Sha256
    seed: Seed
    worlds: Count
    views: Count
    splits: Annotated[Mapping[SplitName, Share], Field(min_length=1)]
    software: Mapping[Label, Label] = field(default_factory=dict)


class DatasetPart(NamedTuple):
    """Worlds of a data set that one command has rendered.

    Attributes:
        first_world: The number of its first world.
        info: What it was planned as; its worlds are counted from 0.
    """

    first_world: int
    info: DatasetInfo


@dataclass(frozen=True)
class DatasetInfo(Record):
    """What a data set is, written before its first world.

    Attributes:
        config: The complete configuration, defaults included; of a merged set, that of its first
            part, see `parts`.
        config_sha256: Its hash.
        seed: Seed that all worlds are derived from.
        worlds, views: Planned number of worlds, and of views of each; of a merged set, of all
            worlds, and the most.
        splits: Share of the worlds by the split's name.
        software: Versions by name.
        options: What else the command was given.
        version: Version of the files.
        merged: The sets that it was merged from, in the order of their worlds; only if it was.
    """

    optional: ClassVar[frozenset[str]] = frozenset({"merged"})

    config: Annotated[Mapping[str, Any], fields_of(_ConfigFields)]
    config_sha256: Sha256
    seed: Seed
    worlds: Count
    views: Count
    splits: Annotated[Mapping[SplitName, Share], Field(min_length=1)]
    software: Mapping[Label, Label] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    version: Number = FORMAT_VERSION
    merged: tuple[MergedSet, ...] = ()

    @property
    def parts(self) -> tuple[DatasetPart, ...]:
        """What each command has rendered: the set itself, or those that it was merged from."""
        if not self.merged:
            return (DatasetPart(0, self),)
        return tuple(DatasetPart(each.first_world, _info_of(each)) for each in self.merged)

    def part_of(self, world: int) -> DatasetPart:
        """Return the part that a world is in; the last one for worlds beyond all."""
        return [each for each in self.parts if each.first_world <= world][-1]

    def check_configs(self, name: str) -> None:
        """Raise unless the configuration of each part has the hash that is recorded beside it.

        Raises:
            InvalidInputError: One was changed after the data set had been written; errors call
                the head ``name``.
        """
        for part in self.parts:
            found = text_sha256(canonical_text(part.info.config))
            if found != part.info.config_sha256:
                where = f", from world {part.first_world}" if self.merged else ""
                received = f"a configuration with the hash {found}"
                expected = f"that of the recorded hash, {part.info.config_sha256}"
                raise InvalidInputError(f"{name}{where}: config", received, expected)

    @classmethod
    def from_json(cls, text: str | bytes, name: str = "record") -> Self:
        """Return the head of a data set; errors call it ``name``.

        Raises:
            InvalidInputError: It is none, or of a later version.
        """
        info = super().from_json(text, name)
        if info.version != FORMAT_VERSION:
            expected = f"version {FORMAT_VERSION}, which this program reads"
            raise InvalidInputError(f"{name}: version", info.version, expected)
        firsts = [0, *accumulate(each.worlds for each in info.merged)]
        if info.merged and [*(m.first_world for m in info.merged), info.worlds] != firsts:
            received = [each.first_world for each in info.merged]
            expected = f"{firsts[:-1]}, and {firsts[-1]} worlds, as many as all parts have"
            raise InvalidInputError(f"{name}: merged: first_world", received, expected)
        return info


def _info_of(merged: MergedSet) -> DatasetInfo:
    names = (each.name for each in fields(MergedSet) if each.name not in ("place", "first_world"))
    return DatasetInfo(**{name: getattr(merged, name) for name in names})
