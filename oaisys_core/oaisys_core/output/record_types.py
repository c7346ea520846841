"""What the fields of records may be: types, ranges, finite numbers, lengths.

A record is a file that somebody else may have written, such as a line of a manifest. `check_as`
checks one when it is read, so that whatever uses it later meets no surprise.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import cache
from math import isfinite
from typing import Annotated, Any, ClassVar, TypeVar, cast

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    Strict,
    TypeAdapter,
    ValidationError,
)
from pydantic_core import core_schema

from oaisys_core.config.expectations import faults_of
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json
from oaisys_core.files.names import NAME_EXPECTED, is_name
from oaisys_core.types import EQUIDISTANT, PLUMB_BOB

MAX_BYTES = 1 << 50
MAX_FILE_BYTES = 1 << 31
MAX_SIDE_PX = 65536
MAX_SECONDS = 1e10
MAX_METRES = 1e10

_CHECKED = ConfigDict(extra="forbid", allow_inf_nan=False)

KindT = TypeVar("KindT")


def _type_name(text: str) -> str:
    if not is_name(text):
        raise ValueError(f"expected {NAME_EXPECTED}")
    return text


def _without_nul(text: str) -> str:
    if "\0" in text:
        raise ValueError("expected text without the character 0, with which texts end in C")
    return text


def _in_a_line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("expected text in a line, without control characters")
    return text


def _object_in(text: str) -> dict[str, Any]:
    data = parse_json(text) if text else {}
    if type(data) is not dict:
        raise ValueError("expected a JSON object, or nothing")
    return data


def _json_object(text: str) -> str:
    _object_in(text)
    return text


def _exposures(text: str) -> str:
    values = _object_in(text).values()
    if not all(type(value) in (int, float) and isfinite(value) for value in values):
        raise ValueError("expected finite numbers as JSON by the camera's name, or nothing")
    return text


def _split(text: str) -> str:
    if not text.isidentifier():
        raise ValueError("expected a name out of letters, digits and _, such as train")
    return text


Text = Annotated[str, Strict(), Field(max_length=100_000), AfterValidator(_without_nul)]
Label = Annotated[Text, Field(max_length=1000), AfterValidator(_in_a_line)]
"""What people read, in a line."""

Name = Annotated[Text, AfterValidator(_type_name)]
"""What may become the name of a file, see `oaisys_core.files.names`."""

SplitName = Annotated[str, Strict(), Field(max_length=64), AfterValidator(_split)]
Sha256 = Annotated[str, Strict(), Field(pattern=r"^[0-9a-f]{64}$")]
JsonObject = Annotated[str, Strict(), AfterValidator(_json_object)]
"""Empty, or a JSON object as text."""

Seed = Annotated[int, Strict(), Field(ge=0, lt=2**64)]
Number = Annotated[int, Strict(), Field(ge=0, lt=2**63)]
Ordinal = Annotated[int, Strict(), Field(ge=0, lt=1_000_000)]
"""Of a world in a data set, or of a view in a world."""

Count = Annotated[int, Strict(), Field(ge=0, le=1_000_000)]
Bytes = Annotated[int, Strict(), Field(ge=0, le=MAX_BYTES)]
FileBytes = Annotated[int, Strict(), Field(ge=0, le=MAX_FILE_BYTES)]
"""Of a file that is read as a whole, such as an image."""

Side = Annotated[int, Strict(), Field(ge=1, le=MAX_SIDE_PX)]
Shape = Annotated[tuple[Side, ...], Field(min_length=2, max_length=3)]
Bounded = Annotated[float, Strict(), Field(ge=-MAX_METRES, le=MAX_METRES, allow_inf_nan=False)]
Seconds = Annotated[float, Strict(), Field(ge=0, le=MAX_SECONDS, allow_inf_nan=False)]
Share = Annotated[float, Strict(), Field(gt=0, le=1, allow_inf_nan=False)]
Degrees = Annotated[float, Strict(), Field(ge=-360, le=360, allow_inf_nan=False)]
LabelId = Annotated[int, Field(ge=0, lt=2**16)]
"""A key of JSON is text, so it may be."""

InstanceId = Annotated[int, Field(ge=0, lt=2**32)]

_Row = tuple[Bounded, Bounded, Bounded, Bounded]


def fields_of(kind: Any) -> Any:
    """Return the mark of a mapping, or other plain data, that is checked as another type."""

    def schema(_: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.no_info_wrap_validator_function(_as_it_is, handler(kind))

    return GetPydanticSchema(schema)


def _as_it_is(value: Any, handler: core_schema.ValidatorFunctionWrapHandler) -> Any:
    handler(value)
    return value


Matrix = Annotated[
    tuple[tuple[float, ...], ...],
    GetPydanticSchema(lambda _, handler: handler(tuple[_Row, _Row, _Row, _Row])),
]
"""A 4x4 matrix, as a list of rows."""


@dataclass(frozen=True)
class _CameraFields:
    __pydantic_config__: ClassVar[ConfigDict] = _CHECKED

    width_px: Side
    height_px: Side
    fx_px: Annotated[Bounded, Field(gt=0)]
    fy_px: Annotated[Bounded, Field(gt=0)]
    cx_px: Bounded
    cy_px: Bounded
    distortion: Annotated[tuple[Bounded, ...], Field(max_length=5)]
    K: tuple[tuple[Bounded, Bounded, Bounded], ...]
    distortion_model: Text = PLUMB_BOB


def _camera(fields: _CameraFields) -> _CameraFields:
    coefficients = {PLUMB_BOB: (0, 5), EQUIDISTANT: (0, 4)}
    known = coefficients.get(fields.distortion_model)
    if known is None:
        raise ValueError(f"expected the distortion_model {' or '.join(coefficients)}")
    if len(fields.distortion) not in known:
        raise ValueError(f"expected {known[1]} coefficients as distortion, or none")
    if len(fields.K) != 3:
        raise ValueError("expected three rows of three numbers as K")
    return fields


@dataclass(frozen=True)
class _PoseFields:
    __pydantic_config__: ClassVar[ConfigDict] = _CHECKED

    position_m: tuple[Bounded, Bounded, Bounded]
    quat_xyzw: tuple[Bounded, Bounded, Bounded, Bounded]


@dataclass(frozen=True)
class _ProvenanceFields:
    __pydantic_config__: ClassVar[ConfigDict] = _CHECKED

    seed: Seed
    batch_seed: Seed
    config_sha256: Sha256
    backend: Label
    backend_version: Label
    quality: Label
    render_samples: Number
    device: Label = "cpu"
    stage_seed: Seed = 0
    asset_seed: Seed = 0
    metadata_json: JsonObject = ""
    previous_poses_json: JsonObject = ""
    exposures_json: Annotated[str, Strict(), AfterValidator(_exposures)] = ""
    motion_json: JsonObject = ""


@dataclass(frozen=True)
class _OdometryFields:
    __pydantic_config__: ClassVar[ConfigDict] = _CHECKED

    pose: _PoseFields
    sigma_m: Bounded
    sigma_rad: Bounded


@dataclass(frozen=True)
class _SensorFields:
    __pydantic_config__: ClassVar[ConfigDict] = _CHECKED

    intrinsics: Annotated[_CameraFields, AfterValidator(_camera)]
    T_map_camera: Matrix
    images: Mapping[Name, Text]


@dataclass(frozen=True)
class _LidarFields:
    __pydantic_config__: ClassVar[ConfigDict] = _CHECKED

    T_map_lidar: Matrix
    points: Text


@dataclass(frozen=True)
class SampleFile:
    """The JSON file of a sample, see `oaisys_core.output.records.sample_record`."""

    batch_id: Number
    sample_id: Number
    rig_pose: _PoseFields
    provenance: _ProvenanceFields
    render_time_s: Seconds
    sensors: Mapping[Name, _SensorFields]
    lidars: Mapping[Name, _LidarFields] = field(default_factory=dict)
    odometry: _OdometryFields | None = None


CameraFields = Annotated[
    Mapping[str, Any], fields_of(Annotated[_CameraFields, AfterValidator(_camera)])
]
PoseFields = Annotated[Mapping[str, Any], fields_of(_PoseFields)]
ProvenanceFields = Annotated[Mapping[str, Any], fields_of(_ProvenanceFields)]


def check_camera(record: Any, name: str) -> Mapping[str, Any]:
    """Return the record of a camera, see `check_as`."""
    check_as(_CameraFields, record, name)
    return cast("Mapping[str, Any]", record)


def check_as(kind: type[KindT], data: Any, name: str) -> KindT:
    """Return data as a type whose annotations are those of this module.

    Args:
        kind: A dataclass.
        data: What JSON gave.
        name: Of the file, and of the line in it, for errors.

    Raises:
        InvalidInputError: A field has another type, is out of its range, or is not finite.
    """
    try:
        return cast("KindT", _adapter(cast("Hashable", kind)).validate_python(data))
    except ValidationError as error:
        fault = faults_of(error, data, kind)[0]
        where = ": ".join(part for part in (name, fault.path) if part)
        raise InvalidInputError(where, fault.received, fault.expected) from error


@cache
def _adapter(kind: Hashable) -> TypeAdapter[Any]:
    return TypeAdapter(cast("type", kind))
