"""Records of a data set: what it is, each of its frames, the legend of a world; to JSON and back.

A *frame* is what one camera shows at one view of a world, in all modalities.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from oaisys_core.dataset.parsing import parsed_json, shortened
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import is_rigid
from oaisys_core.output.record_types import (
    Bytes,
    CameraFields,
    Count,
    Degrees,
    InstanceId,
    Label,
    LabelId,
    Matrix,
    Name,
    Number,
    Place,
    PoseFields,
    ProvenanceFields,
    Seconds,
    Seed,
    Sha256,
    Shape,
    Share,
    SplitName,
    Text,
    checked_as,
    fields_of,
)
from oaisys_core.output.records import (
    intrinsics_from_record,
    pose_from_record,
    provenance_from_record,
)
from oaisys_core.types import FloatArray, FrameName, PinholeIntrinsics, SampleOutline

if TYPE_CHECKING:
    from oaisys_core.dataset.scans import ScanRecord

FORMAT_VERSION = 1
"""Version of the files; readers refuse later ones."""

VARYING_FIELDS = frozenset({"worker", "seconds"})
"""The fields of a record that may differ between two runs of the same data set."""


@dataclass(frozen=True)
class ImageRecord:
    """An image file in a shard.

    Attributes:
        file: Name of the member of the tar file.
        offset, size: Where the file's bytes begin in the tar file, and how many they are.
        sha256: Hash of the file's bytes.
        pixels_sha256: Hash of the array's bytes, little-endian, row by row.
        dtype, shape: Of the array, such as ``uint8`` and (480, 640, 3).
    """

    file: Name
    offset: Bytes
    size: Bytes
    sha256: Sha256
    pixels_sha256: Sha256
    dtype: Annotated[Label, Field(max_length=32)]
    shape: Shape


@dataclass(frozen=True)
class FrameRecord:
    """A line of the manifest: what a frame shows, and how to render it again.

    Attributes:
        frame_id: Names it in the data set: ``000012_0003_camera`` is world, view and sensor.
        world, view: Counted from 0; the simulation's batch and sample are each one more.
        split: ``train``, ``val``, ``test`` or another name; that of its world.
        world_seed: Seed that the world was drawn from.
        metadata: What the world and the view were given beyond the configuration.
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

    frame_id: Name
    world: Place
    view: Place
    sensor: Name
    split: SplitName
    world_seed: Seed
    config_sha256: Label
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
    def pose(self) -> FloatArray:
        """``T_map_camera`` as a (4, 4) array."""
        return np.array(self.T_map_camera, np.float64)

    def contradictions(self) -> Iterator[tuple[str, object, str]]:
        """Yield each field that contradicts others: its name, its value, what was expected."""
        yield from contradictions(self, self.frame_id, "frame_id", "T_map_camera")
        camera = self.camera
        size = (camera.height_px, camera.width_px)
        for modality, image in self.images.items():
            if image.shape[:2] != size:
                yield f"images.{modality}.shape", image.shape, f"{size}, the size of its camera"

    def outline(self) -> SampleOutline:
        """Return the outline from which `Simulation.repeat` renders this sensor's images again."""
        return recorded_outline(self, self.images)

    def to_json(self) -> str:
        """Return the record and its hash as one line, without its end; inverse: `from_json`."""
        return signed(asdict(self), VARYING_FIELDS)

    @classmethod
    def from_json(cls, line: str | bytes, name: str = "line") -> FrameRecord:
        """Return the record of a line; errors call it ``name``.

        Raises:
            InvalidInputError: It is not the record of a frame.
        """
        return checked_as(cls, record_fields(cls, line, name), name)


def contradictions(
    record: FrameRecord | ScanRecord, name: str, name_field: str, pose_field: str
) -> Iterator[tuple[str, object, str]]:
    """Yield what contradicts itself in a record of any sensor, see `FrameRecord.contradictions`."""
    expected = frame_id(record.world, record.view, record.sensor)
    if name != expected:
        yield name_field, name, f"{expected}, after its world, view and sensor"
    if not is_rigid(record.pose):
        yield pose_field, record.pose.tolist(), "a rotation and a translation"


def recorded_outline(record: FrameRecord | ScanRecord, modalities: Iterable[str]) -> SampleOutline:
    """Return the outline from which `Simulation.repeat` renders one sensor's data again."""
    return SampleOutline(
        batch_id=record.world + 1,
        sample_id=record.view + 1,
        rig_pose=pose_from_record(record.rig_pose),
        frames=tuple(FrameName(record.sensor, modality) for modality in modalities),
        provenance=provenance_from_record(record.provenance),
    )


def world_name(world: int) -> str:
    """Return the name of a world's files, such as ``world_000012``."""
    return f"world_{world:06d}"


def frame_id(world: int, view: int, sensor: str) -> str:
    """Return the id of a frame, such as ``000012_0003_camera``."""
    return f"{world:06d}_{view:04d}_{sensor}"


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
class WorldLegend:
    """What the ids in the label images of a world mean.

    Attributes:
        labels: Label by semantic id, on all levels; 0, no label, is not among them.
        instances: Objects by instance id.
    """

    labels: Mapping[LabelId, Label]
    instances: Mapping[InstanceId, LegendInstance]

    def to_json(self) -> str:
        """Return the legend as JSON; inverse: `from_json`."""
        legend = WorldLegend(
            dict(sorted(self.labels.items())), dict(sorted(self.instances.items()))
        )
        return signed(asdict(legend))

    @classmethod
    def from_json(cls, text: str | bytes, name: str = "legend") -> WorldLegend:
        """Return the legend of a JSON text; errors call it ``name``.

        Raises:
            InvalidInputError: It is no legend.
        """
        return checked_as(cls, record_fields(cls, text, name), name)


@dataclass(frozen=True)
class WorldFailure:
    """A world that could not be made.

    Attributes:
        world: Its index.
        split: The split that it would have been in.
        world_seed: Seed that it was drawn from.
        reason: The error.
        attempts: How often it was tried.
    """

    world: Place
    split: SplitName
    world_seed: Seed
    reason: Text
    attempts: Number = 1

    def to_json(self) -> str:
        """Return the failure as JSON; inverse: `from_json`."""
        return json.dumps(asdict(self), indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str | bytes, name: str = "failure") -> WorldFailure:
        """Return the failure of a JSON text.

        Raises:
            InvalidInputError: It is none.
        """
        return checked_as(cls, record_fields(cls, text, name), name)


@dataclass(frozen=True)
class _ConfigFields:
    """What readers use of a configuration, which may be that of another version."""

    sensors: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class DatasetInfo:
    """What a data set is, written before its first world.

    Attributes:
        config: The complete configuration, defaults included.
        config_sha256: Its hash.
        seed: Seed that all worlds are derived from.
        worlds, views: Planned number of worlds, and of views of each.
        splits: Share of the worlds by the split's name.
        software: Versions by name.
        options: What else the command was given.
        version: Version of the files.
    """

    config: Annotated[Mapping[str, Any], fields_of(_ConfigFields)]
    config_sha256: Label
    seed: Seed
    worlds: Count
    views: Count
    splits: Annotated[Mapping[SplitName, Share], Field(min_length=1)]
    software: Mapping[Label, Label] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    version: Number = FORMAT_VERSION

    def to_json(self) -> str:
        """Return the head of the data set as JSON; inverse: `from_json`."""
        return json.dumps(asdict(self), indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str | bytes, name: str = "dataset.json") -> DatasetInfo:
        """Return the head of a data set; errors call it ``name``.

        Raises:
            InvalidInputError: It is none, or of a later version.
        """
        info = checked_as(cls, record_fields(cls, text, name), name)
        if info.version != FORMAT_VERSION:
            expected = f"version {FORMAT_VERSION}, which this program reads"
            raise InvalidInputError(f"{name}: version", info.version, expected)
        return info


SHA256 = "sha256"
"""Key of the hash of a line of the manifest, or of a legend: of its JSON text without the hash."""


def is_intact(text: str | bytes) -> bool:
    """Return whether a line of the manifest or a legend has the hash of its content."""
    try:
        data = parsed_json(text, SHA256)
        found = data.pop(SHA256)
    except (InvalidInputError, KeyError, AttributeError, TypeError):
        return False
    return bool(found == _sha256(data, VARYING_FIELDS))


def signed(data: dict[str, Any], without: Collection[str] = ()) -> str:
    """Return JSON with a hash of all fields but those in ``without``; see `is_intact`."""
    return json.dumps({**data, SHA256: _sha256(data, without)}, separators=(",", ":"))


def _sha256(data: Mapping[str, Any], without: Collection[str]) -> str:
    kept = {name: value for name, value in data.items() if name not in without}
    return hashlib.sha256(json.dumps(kept, separators=(",", ":")).encode()).hexdigest()


def record_fields(kind: type, text: str | bytes, name: str) -> dict[str, Any]:
    """Return the fields of a record as JSON has them.

    Raises:
        InvalidInputError: They are not those of a dataclass; the error calls the text ``name``.
    """
    data = parsed_json(text, name)
    known = {each.name for each in fields(kind)}
    if isinstance(data, dict):
        data.pop(SHA256, None)
    if not isinstance(data, dict) or set(data) != known:
        received = sorted(data) if isinstance(data, dict) else shortened(text)
        raise InvalidInputError(name, received, f"the keys {', '.join(sorted(known))}")
    return data
