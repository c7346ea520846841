"""Requests that nobody in his right mind sends, and what a server made of them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import grpc
import numpy as np
from google.protobuf.descriptor import MethodDescriptor
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.struct_pb2 import Struct
from waiting import PATIENCE_S

from oaisys_grpc.pb.legacy import oaisys_pb2 as legacy
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

METHODS: dict[str, MethodDescriptor] = {
    f"/{service.full_name}/{method.name}": method
    for service in (
        pb.DESCRIPTOR.services_by_name["SimulatorService"],
        legacy.DESCRIPTOR.services_by_name["Oaisys"],
    )
    for method in service.methods
}
OURS, ORIGINAL = "/oaisys.v1.SimulatorService/", "/oaisys.Oaisys/"
STEPS = ("StepBatch", "StepSample", "RenderSample")
SHARES = {"StepBatch": 0.05, "StepSample": 0.3, "RenderSample": 0.4, "GetGroundTruthMesh": 0.2}
"""How often calls are drawn that take long; all others once."""

NEVER = "EndSimulation"
"""Sent only where its bytes are no message: otherwise it does what it says."""

NUMBERS = (0.0, -0.0, -1.0, 0.5, 1e-320, 1e12, -1e300, 2.0**31, 2.0**53, math.nan, math.inf)
TEXTS = ("", "x" * 3000, "\0", "../../etc/passwd", "operations/1", "depth", "camera", "\U0001f4a5")
UNDERSTOOD = frozenset(
    {
        grpc.StatusCode.INVALID_ARGUMENT,
        grpc.StatusCode.FAILED_PRECONDITION,
        grpc.StatusCode.NOT_FOUND,
        grpc.StatusCode.RESOURCE_EXHAUSTED,
    }
)
"""What a request may be refused with."""


class Mutator:
    """Draws requests: random bytes, valid ones, and valid ones with something wrong in them."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._paths = list(METHODS)
        share = [SHARES.get(path.split("/")[-1], 1.0) for path in self._paths]
        self._shares = np.array(share) / sum(share)

    def requests(self) -> Iterator[tuple[str, bytes]]:
        """Yield paths of methods and messages without end."""
        while True:
            path = self._paths[self._rng.choice(len(self._paths), p=self._shares)]
            data = self._drawn(METHODS[path])
            if path.endswith(NEVER) and parsed(path, data) is not None:
                continue
            yield path, data

    def _drawn(self, method: MethodDescriptor) -> bytes:
        how = self._rng.random()
        if how < 0.2:
            return self._rng.bytes(int(self._rng.integers(1, 200)))
        message = self._valid(method)
        if how < 0.55:
            self._spoil(message)
        data = message.SerializeToString()
        return data if how < 0.6 else self._mutated(data)

    def _valid(self, method: MethodDescriptor) -> Message:
        message = GetMessageClass(method.input_type)()
        values: dict[str, Any] = {}
        fields = method.input_type.fields_by_name
        if "metadata" in fields:
            values["metadata"] = self._metadata(method.name == "StepBatch")
        if "name" in fields:
            values["name"] = f"operations/{self._rng.integers(1, 50)}"
        if "batch_id" in fields:
            values |= {"batch_id": int(self._rng.integers(3)), "sample_id": 1}
        if "points_m" in fields:
            values["points_m"] = self._rng.uniform(-9, 9, 9).tolist()
        if "modalities" in fields:
            values["modalities"] = ["depth"]
        if "sensorModuleRequest" in fields:
            values["sensorModuleRequest"] = legacy.SensorModuleRequest(
                pose=legacy.SensorModuleRequest.PoseType(z=self._rng.uniform(1, 9), q_w=1)
            )
        return type(message)(**values)

    def _metadata(self, is_batch: bool) -> pb.ModuleMetadata:
        metadata = pb.ModuleMetadata()
        p, q = metadata.sensor.pose.position_m, metadata.sensor.pose.orientation
        p.x, p.y, p.z = self._rng.uniform((-9, -9, 1), 9)
        q.x, q.y, q.z, q.w = 0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)
        optics: Any = {"camera": {"lens": {"f_number": 4.0}, "fx_px": 14.0}}
        metadata.sensor.settings.update({"cameras": optics})
        metadata.environment.update({"sun_elevation_deg": [20, 60], "haze": {"visibility_m": 900}})
        metadata.render.update({"quality": "standard", "effects": {"vignetting": 0.5}})
        standing: Any = {
            "shape": "bush",
            "position_m": [1, 2, 0],
            "label": "bush",
            "semantic_id": 30,
        }
        metadata.asset.update({"add": {"it": standing}})
        if is_batch:
            metadata.asset.update({"count_factor": 0.5})
            metadata.custom.update({"stage": {"roughness": 0.5}})
        return metadata

    def _spoil(self, message: Message) -> None:
        """Put something odd in the place of one value, wherever it is."""
        leaves = list(_leaves(message))
        if not leaves:
            return
        holder, key = leaves[self._rng.integers(len(leaves))]
        odd = (NUMBERS[self._rng.integers(len(NUMBERS))], TEXTS[self._rng.integers(len(TEXTS))])
        if isinstance(holder, Struct):
            others: tuple[Any, ...] = (None, True, {}, [], {"x": {"y": [None]}}, [odd[0]] * 99)
            choice = [*odd, *odd, *others][self._rng.integers(4 + len(others))]
            if self._rng.random() < 0.3:
                key += "_"
            holder[key] = choice
        elif isinstance(getattr(holder, key), float):
            setattr(holder, key, odd[0])
        elif isinstance(getattr(holder, key), str):
            setattr(holder, key, odd[1])
        else:
            holder.ClearField(key)

    def _mutated(self, data: bytes) -> bytes:
        """Flip, cut out, double, or put in bytes."""
        changed = bytearray(data)
        for _ in range(int(self._rng.integers(1, 4))):
            at = int(self._rng.integers(len(changed) + 1))
            end = at + int(self._rng.integers(1, 9))
            kind = self._rng.integers(4)
            if kind == 0 and at < len(changed):
                changed[at] ^= 1 << int(self._rng.integers(8))
            elif kind == 1:
                del changed[at:end]
            elif kind == 2:
                changed[at:at] = changed[at:end]
            else:
                changed[at:at] = self._rng.bytes(end - at)
        return bytes(changed)


@dataclass
class Target:
    """A server that is sent bytes, and what was noticed.

    Attributes:
        counts: Calls by the status they ended with.
        unexpected: What should not have happened, in words.
    """

    channel: grpc.Channel
    counts: Counter[str] = field(default_factory=Counter)
    unexpected: list[str] = field(default_factory=list)

    def send(self, path: str, data: bytes) -> bool:
        """Send a message, wait for all of its consequences; return whether it took a step."""
        message = parsed(path, data)
        try:
            answers = self._call(path, data)
        except grpc.RpcError as error:
            self._note(path, data, error)
            return False
        self.counts["OK"] += 1
        if message is None:
            self.unexpected.append(f"{path} took what is no message: {data!r}")
        return path.split("/")[-1] in STEPS and self._has_stepped(path, answers)

    def ask(self, path: str, request: Message) -> Any:
        """Call a unary method that must succeed."""
        return _reply(path, self._call(path, request.SerializeToString())[-1])

    def _call(self, path: str, data: bytes) -> list[bytes]:
        streams: Any = self.channel.unary_stream(path)
        if METHODS[path].server_streaming:
            return list(streams(data, timeout=PATIENCE_S))
        answers: Any = self.channel.unary_unary(path)
        return [answers(data, timeout=PATIENCE_S)]

    def _note(self, path: str, data: bytes, error: grpc.RpcError) -> None:
        call: Any = error
        code = call.code()
        self.counts[code.name] += 1
        if code not in UNDERSTOOD:
            self.unexpected.append(f"{path} {code.name} {call.details()}: {data!r}")

    def _has_stepped(self, path: str, answers: list[bytes]) -> bool:
        if path.startswith(ORIGINAL):
            poll = "RenderFinished" if path.endswith("StepSample") else "BatchCreationFinished"
            reply = _reply(path, answers[-1])
            while reply.successRet and self.ask(ORIGINAL + poll, legacy.Empty()).state == 1:
                pass
            return bool(reply.successRet)
        if path.endswith("RenderSample"):
            return True
        name = _reply(path, answers[-1]).operation.name
        watch = pb.WatchOperationRequest(name=name).SerializeToString()
        last = _reply(OURS + "WatchOperation", self._call(OURS + "WatchOperation", watch)[-1])
        if last.operation.state == pb.OPERATION_STATE_SUCCEEDED:
            return True
        error = last.operation.error
        self.counts[f"operation {error.reason}"] += 1
        if error.code not in {code.value[0] for code in UNDERSTOOD}:
            self.unexpected.append(f"{path} {error.reason}: {error.message}")
        return False


def parsed(path: str, data: bytes) -> Message | None:
    """The request that the bytes are, if any."""
    try:
        message: Message = GetMessageClass(METHODS[path].input_type).FromString(data)
    except DecodeError:
        return None
    return message


def _reply(path: str, data: bytes) -> Any:
    return GetMessageClass(METHODS[path].output_type).FromString(data)


def _leaves(message: Any) -> Iterator[tuple[Any, str]]:
    """Yield where values are in a message: the message or struct that holds each, and its key."""
    if isinstance(message, Struct):
        for key, value in message.fields.items():
            yield message, key
            if value.HasField("struct_value"):
                yield from _leaves(value.struct_value)
        return
    for described, value in message.ListFields():
        if isinstance(value, Message):
            yield from _leaves(value)
        else:
            yield message, described.name
