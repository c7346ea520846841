"""A step's pose, names and metadata as messages, and back; in pairs.

Metadata travel as typed messages, and as Structs what these do not hold. The typed fields have the
names of the modules' keys, so that a new field needs no code here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.struct_pb2 import Struct, Value

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import check_pose
from oaisys_core.types import ModuleMetadata, Pose
from oaisys_grpc.contract.conversion import Conversion
from oaisys_grpc.contract.metadata_bounds import check_size, check_values
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

MAX_NAMES = 1000
"""Sensors or modalities in one request."""

_TYPED = ("environment", "asset", "render")
"""Parts of metadata that come as a typed message, as a Struct, or as both."""

_LISTS = {
    kind.DESCRIPTOR.full_name: tuple(kind.DESCRIPTOR.fields_by_name)
    for kind in (pb.Range, pb.Color, pb.Vector3, pb.Quaternion)
}
"""Messages that stand for a list of numbers, and their fields in its order."""

_STRUCT = Struct.DESCRIPTOR.full_name
_RANGE = pb.Range.DESCRIPTOR.full_name
_INT32 = range(-(2**31), 2**31)


def pose_to_proto(pose: Pose) -> pb.Pose:
    """Return the message of a pose; inverse: `pose_from_proto`."""
    x, y, z, w = pose.quat_xyzw
    return pb.Pose(
        position_m=vector_to_proto(pose.position_m),
        orientation=pb.Quaternion(x=x, y=y, z=z, w=w),
    )


def pose_from_proto(message: pb.Pose) -> Pose:
    """Return the pose exactly as it was sent; `metadata_from_proto` checks those it takes."""
    q = message.orientation
    return Pose(vector_from_proto(message.position_m), (q.x, q.y, q.z, q.w))


def vector_to_proto(vector: tuple[float, float, float]) -> pb.Vector3:
    """Return the message of a vector; inverse: `vector_from_proto`."""
    x, y, z = vector
    return pb.Vector3(x=x, y=y, z=z)


def vector_from_proto(message: pb.Vector3) -> tuple[float, float, float]:
    """Return the vector of a message."""
    return (message.x, message.y, message.z)


VECTOR = Conversion(vector_to_proto, vector_from_proto)
POSE = Conversion(pose_to_proto, pose_from_proto)


def metadata_to_proto(metadata: ModuleMetadata) -> pb.ModuleMetadata:
    """Return the message of a step's metadata, typed as far as it goes.

    Inverse: `metadata_from_proto`.

    Raises:
        InvalidInputError: A value is neither JSON nor, in the part ``sensor``, a pose; or the
            metadata are larger or more nested than a server takes.
    """
    message = pb.ModuleMetadata()
    if metadata.sensor is not None:
        message.sensor.SetInParent()
    settings = dict(metadata.sensor or {})
    if "pose" in settings:
        pose = settings.pop("pose")
        if not isinstance(pose, Pose):
            raise InvalidInputError("metadata.sensor.pose", pose, "a Pose")
        message.sensor.pose.CopyFrom(pose_to_proto(pose))
    settings = fill(message.sensor, settings, ["cameras"]) if settings else settings
    if settings:
        message.sensor.settings.CopyFrom(struct_to_proto(settings, "metadata.sensor"))
    for name in _TYPED:
        part = metadata.part(name)
        if part is None:
            continue
        typed = getattr(message, f"typed_{name}")
        rest = fill(typed, part, typed.DESCRIPTOR.fields_by_name)
        if rest or not part:
            getattr(message, name).CopyFrom(struct_to_proto(rest, f"metadata.{name}"))
    if metadata.custom:
        message.custom.CopyFrom(struct_to_proto(metadata.custom, "metadata.custom"))
    check_size(message)
    return message


def metadata_from_proto(message: pb.ModuleMetadata) -> ModuleMetadata:
    """Return a step's metadata; an absent part stays absent.

    Raises:
        InvalidInputError: The pose is none or among the other settings, or a key came both typed
            and in a Struct.
    """
    parts: dict[str, Any] = {}
    if message.HasField("sensor"):
        typed = values_of(pb.SensorMetadata(cameras=message.sensor.cameras))
        settings = struct_from_proto(message.sensor.settings)
        parts["sensor"] = join("metadata.sensor", settings, typed)
        if "pose" in parts["sensor"]:
            received = parts["sensor"]["pose"]
            raise InvalidInputError("metadata.sensor.settings.pose", received, "the field pose")
        if message.sensor.HasField("pose"):
            pose = pose_from_proto(message.sensor.pose)
            check_pose(pose.position_m, pose.quat_xyzw, "metadata.sensor.pose")
            parts["sensor"]["pose"] = pose
    present = {field.name for field, _ in message.ListFields()}
    for name in _TYPED:
        if present & {name, f"typed_{name}"}:
            typed = values_of(getattr(message, f"typed_{name}"))
            open_ended = struct_from_proto(getattr(message, name))
            parts[name] = join(f"metadata.{name}", open_ended, typed)
    if message.HasField("custom"):
        parts["custom"] = struct_from_proto(message.custom)
    return ModuleMetadata(**parts)


def names(given: Sequence[str], field: str) -> tuple[str, ...]:
    """Return the names in a field of a request.

    Raises:
        InvalidInputError: There are more than `MAX_NAMES`.
    """
    if len(given) > MAX_NAMES:
        raise InvalidInputError(field, f"{len(given)} names", f"at most {MAX_NAMES}")
    return tuple(given)


class _NotTypedError(ValueError):
    """A value that no typed field can hold so that it comes back as it was."""


def values_of(message: Message) -> dict[str, Any]:
    """Return what is set in a typed message, by key; inverse: `fill`."""
    return {field.name: _value(field, value) for field, value in message.ListFields()}


def fill(message: Message, values: Mapping[str, Any], keys: Iterable[str]) -> dict[str, Any]:
    """Set those of ``keys`` that a typed message can hold; return all values that it cannot."""
    rest = dict(values)
    fields: Any = message.DESCRIPTOR.fields_by_name
    for key in keys:
        if key not in values:
            continue
        try:
            _set(message, fields[key], values[key])
        except (_NotTypedError, InvalidInputError, UnicodeError, OverflowError):
            message.ClearField(key)
        else:
            del rest[key]
    return rest


def join(path: str, open_ended: dict[str, Any], typed: dict[str, Any]) -> dict[str, Any]:
    """Return the values that came open-ended and those that came typed.

    Raises:
        InvalidInputError: A key came both ways.
    """
    for key in open_ended:
        if key in typed:
            expected = "a value in the typed message or in the Struct, not in both"
            raise InvalidInputError(f"{path}.{key}", open_ended[key], expected)
    return {**open_ended, **typed}


def _value(field: Any, value: Any) -> Any:
    if _is_map(field):
        inner = field.message_type.fields_by_name["value"]
        return {key: _single(inner, entry) for key, entry in value.items()}
    return list(value) if field.is_repeated else _single(field, value)


def _single(field: Any, value: Any) -> Any:
    kind = field.message_type
    if kind is None:
        return whole_as_int(value) if isinstance(value, float) else value
    if kind.full_name == _STRUCT:
        return struct_from_proto(value)
    if kind.full_name == _RANGE and not value.HasField("most"):
        return whole_as_int(value.least)
    if kind.full_name in _LISTS:
        return [whole_as_int(getattr(value, name)) for name in _LISTS[kind.full_name]]
    return values_of(value)


def _set(message: Any, field: Any, value: Any) -> None:
    target = getattr(message, field.name)
    if _is_map(field):
        _check(isinstance(value, Mapping) and bool(value))
        for key, inner in value.items():
            _check(isinstance(key, str))
            _set_message(target[key], inner)
    elif field.is_repeated:
        _check(isinstance(value, list | tuple) and bool(value))
        for inner in value:
            _check(isinstance(inner, str))
            target.append(inner)
    elif field.message_type is None:
        setattr(message, field.name, _scalar(field, value))
    else:
        target.SetInParent()
        _set_message(target, value)


def _set_message(message: Any, value: Any) -> None:
    name = message.DESCRIPTOR.full_name
    if name == _RANGE and _is_number(value):
        message.least = value
    elif name in _LISTS:
        numbers = isinstance(value, list | tuple) and all(map(_is_number, value))
        _check(numbers and len(value) == len(_LISTS[name]))
        for key, number in zip(_LISTS[name], value, strict=True):
            setattr(message, key, number)
    elif name == _STRUCT:
        _check(isinstance(value, Mapping))
        message.CopyFrom(struct_to_proto(value, "metadata"))
    else:
        _check(isinstance(value, Mapping))
        _check(not fill(message, value, message.DESCRIPTOR.fields_by_name))


def _scalar(field: Any, value: Any) -> Any:
    fits = {
        FieldDescriptor.CPPTYPE_DOUBLE: _is_number(value),
        FieldDescriptor.CPPTYPE_INT32: type(value) is int and value in _INT32,
        FieldDescriptor.CPPTYPE_BOOL: isinstance(value, bool),
        FieldDescriptor.CPPTYPE_STRING: isinstance(value, str),
    }
    _check(fits[field.cpp_type])
    return value


def _is_map(field: Any) -> bool:
    return field.message_type is not None and bool(field.message_type.GetOptions().map_entry)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check(fits: bool) -> None:
    if not fits:
        raise _NotTypedError


def struct_to_proto(values: Mapping[str, Any], field: str) -> Struct:
    """Return JSON-able values as a message; inverse: `struct_from_proto`.

    Raises:
        InvalidInputError: They are not as in JSON, too many or too deep.
    """
    check_values(values, field)
    message = Struct()
    try:
        message.update(dict(values))
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError(field, dict(values), "values as in JSON") from error
    return message


def struct_from_proto(message: Struct) -> dict[str, Any]:
    """Return a message's values; numbers that are whole become int again."""
    return {key: _value_from_proto(value) for key, value in message.fields.items()}


def whole_as_int(number: float) -> int | float:
    """Return a number as JSON would have it: whole ones as int."""
    return int(number) if number.is_integer() else number


def _value_from_proto(message: Value) -> Any:
    kind = message.WhichOneof("kind")
    if kind == "struct_value":
        return struct_from_proto(message.struct_value)
    if kind == "list_value":
        return [_value_from_proto(value) for value in message.list_value.values]
    if kind == "number_value":
        return whole_as_int(message.number_value)
    return None if kind in (None, "null_value") else getattr(message, kind)
