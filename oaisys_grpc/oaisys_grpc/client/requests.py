"""The requests of a client, made from the core's types."""

from __future__ import annotations

import uuid
from collections.abc import Sequence

from google.protobuf.duration_pb2 import Duration

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import ModuleMetadata, Pose
from oaisys_grpc.contract.metadata import metadata_to_proto, pose_to_proto
from oaisys_grpc.contract.transfer import Transfer, transfer_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


def step_batch(
    timeout_s: float,
    seed: int | None,
    reuse_stage: bool,
    metadata: ModuleMetadata | None,
    *,
    request_id: str,
) -> pb.StepBatchRequest:
    """Return a request for a new world.

    Raises:
        InvalidInputError: The seed or the metadata do not fit into a message.
    """
    if seed is not None and not -(2**63) <= seed < 2**63:
        raise InvalidInputError("seed", seed, "a whole number from 0 to 2**63 - 1")
    return pb.StepBatchRequest(
        request_id=request_id or _new_id(),
        metadata=_metadata(None, metadata),
        seed=seed,
        reuse_stage=reuse_stage,
        timeout=_duration(timeout_s),
    )


def step_sample(
    timeout_s: float,
    pose: Pose | None,
    metadata: ModuleMetadata | None,
    modalities: Sequence[str],
    sensors: Sequence[str],
    *,
    request_id: str,
) -> pb.StepSampleRequest:
    """Return a request for a sample; a pose goes before that of the metadata.

    Raises:
        InvalidInputError: The metadata do not fit into a message.
    """
    return pb.StepSampleRequest(
        request_id=request_id or _new_id(),
        metadata=_metadata(pose, metadata),
        modalities=modalities,
        sensors=sensors,
        timeout=_duration(timeout_s),
    )


def render_sample(
    pose: Pose | None,
    metadata: ModuleMetadata | None,
    modalities: Sequence[str],
    sensors: Sequence[str],
    transfer: Transfer,
) -> pb.RenderSampleRequest:
    """Return a request for a sample whose frames the same call brings; see `step_sample`."""
    return pb.RenderSampleRequest(
        request_id=_new_id(),
        metadata=_metadata(pose, metadata),
        modalities=modalities,
        sensors=sensors,
        transfer=transfer_to_proto(transfer),
    )


def _metadata(pose: Pose | None, metadata: ModuleMetadata | None) -> pb.ModuleMetadata | None:
    if pose is None:
        return None if metadata is None else metadata_to_proto(metadata)
    message = metadata_to_proto(metadata or ModuleMetadata())
    message.sensor.pose.CopyFrom(pose_to_proto(pose))
    return message


def _duration(seconds: float) -> Duration:
    duration = Duration()
    duration.FromMilliseconds(int(seconds * 1000))
    return duration


def _new_id() -> str:
    return uuid.uuid4().hex
