"""Base of the records of a data set: dataclasses as JSON and back, some with their own hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json
from oaisys_core.geometry import is_rigid
from oaisys_core.output.record_types import Bytes, FileBytes, Name, Sha256, check_as
from oaisys_core.output.records import pose_from_record, provenance_from_record
from oaisys_core.types import FloatArray, FrameName, SampleOutline

SHA256 = "sha256"
"""Key of the hash of a record: of its JSON text without the hash."""

VARYING_FIELDS = frozenset({"worker", "seconds"})
"""The fields of a record that may differ between two runs of the same data set; not hashed."""

SHOWN_CHARACTERS = 80
"""Characters of a refused text that an error shows."""


@dataclass(frozen=True)
class Record:
    """Base of a dataclass that is a JSON text in a data set."""

    has_hash: ClassVar[bool] = False
    """Whether the text is one line that ends with its hash, see `is_intact`."""

    optional: ClassVar[frozenset[str]] = frozenset()
    """Fields with an empty default, which the text leaves out where they are empty."""

    def to_json(self) -> str:
        """Return the record as JSON; inverse: `from_json`."""
        data = self._data()
        if not self.has_hash:
            return json.dumps(data, indent=2) + "\n"
        return json.dumps({**data, SHA256: _sha256(data)}, separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str | bytes, name: str = "record") -> Self:
        """Return the record of a JSON text; errors call it ``name``.

        Raises:
            InvalidInputError: It is none of this kind.
        """
        data = _parse(text, name)
        known = {each.name for each in fields(cls)}
        if isinstance(data, dict):
            data.pop(SHA256, None)
        if not isinstance(data, dict) or not known - cls.optional <= set(data) <= known:
            received = sorted(data) if isinstance(data, dict) else _shorten(text)
            raise InvalidInputError(name, received, f"the keys {', '.join(sorted(known))}")
        return check_as(cls, data, name)

    def _data(self) -> dict[str, Any]:
        data = asdict(self)
        return {name: value for name, value in data.items() if value or name not in self.optional}


@dataclass(frozen=True)
class FileRecord:
    """A file in a shard.

    Attributes:
        file: Name of the member of the tar file.
        offset, size: Where the file's bytes begin in the tar file, and how many they are.
        sha256: Hash of the file's bytes.
    """

    file: Name
    offset: Bytes
    size: FileBytes
    sha256: Sha256

    def verify(self, file: bytes, shard: str) -> bytes:
        """Return the file's bytes in a shard, if they are those of the record.

        Raises:
            InvalidInputError: They are others than recorded.
        """
        found = hashlib.sha256(file).hexdigest()
        if found != self.sha256:
            received, expected = (
                f"bytes with the hash {found[:12]}",
                f"{self.sha256[:12]}, as recorded",
            )
            raise InvalidInputError(f"{shard}: {self.file}", received, expected)
        return file


class SensorRecord(Record):
    """Base of the record of what one sensor measured at one view, with a hash.

    A class names its own id and pose; the fields are in the order of the JSON text.
    """

    has_hash = True
    id_field: ClassVar[str]
    pose_field: ClassVar[str]
    world: int
    view: int
    sensor: str
    split: str
    world_seed: int
    config_sha256: str
    rig_pose: Mapping[str, Any]
    provenance: Mapping[str, Any]

    @property
    def id(self) -> str:
        """The name in the data set: ``000012_0003_camera`` is world, view and sensor."""
        return str(getattr(self, self.id_field))

    @property
    def pose(self) -> FloatArray:
        """The sensor's pose in ``map`` as a (4, 4) array."""
        return np.array(getattr(self, self.pose_field), np.float64)

    @property
    def modalities(self) -> Iterable[str]:
        """The modalities that were measured."""
        raise NotImplementedError

    def contradictions(self) -> Iterator[tuple[str, object, str]]:
        """Yield each field that contradicts others: its name, its value, what was expected."""
        expected = frame_id(self.world, self.view, self.sensor)
        if self.id != expected:
            yield self.id_field, self.id, f"{expected}, after its world, view and sensor"
        if not is_rigid(self.pose):
            yield self.pose_field, self.pose.tolist(), "a rotation and a translation"

    def outline(self) -> SampleOutline:
        """Return the outline from which `Simulation.repeat` makes this sensor's data again."""
        return SampleOutline(
            batch_id=self.world + 1,
            sample_id=self.view + 1,
            rig_pose=pose_from_record(self.rig_pose),
            frames=tuple(FrameName(self.sensor, modality) for modality in self.modalities),
            provenance=provenance_from_record(self.provenance),
        )


def frame_id(world: int, view: int, sensor: str) -> str:
    """Return the id of a frame, such as ``000012_0003_camera``."""
    return f"{world:06d}_{view:04d}_{sensor}"


def world_name(world: int) -> str:
    """Return the name of a world's files, such as ``world_000012``."""
    return f"world_{world:06d}"


def is_intact(text: str | bytes) -> bool:
    """Return whether a record has the hash of its content."""
    try:
        data = _parse(text, SHA256)
        found = data.pop(SHA256)
    except (InvalidInputError, KeyError, AttributeError, TypeError):
        return False
    return bool(found == _sha256(data))


def _sha256(data: Mapping[str, Any]) -> str:
    kept = {name: value for name, value in data.items() if name not in VARYING_FIELDS}
    return hashlib.sha256(json.dumps(kept, separators=(",", ":")).encode()).hexdigest()


def _parse(text: str | bytes, name: str) -> Any:
    """Return the data of a JSON text, within the bounds of `oaisys_core.files.documents`."""
    try:
        return parse_json(text)
    except ValueError as error:
        raise InvalidInputError(name, _shorten(text), f"JSON ({error})") from error


def _shorten(text: str | bytes) -> str:
    shown = text[:SHOWN_CHARACTERS]
    return shown if isinstance(shown, str) else shown.decode("utf-8", "replace")
