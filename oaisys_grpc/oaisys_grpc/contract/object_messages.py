"""Objects of a world as the contract's messages, and back; in pairs."""

from __future__ import annotations

from oaisys_core.types import ModuleMetadata, ObjectPage, ObjectQuery, SceneObject
from oaisys_grpc.contract.conversions import metadata_to_proto, pose_from_proto, pose_to_proto
from oaisys_grpc.contract.limits import names
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

Triple = tuple[float, float, float]


def query_to_proto(query: ObjectQuery, metadata: ModuleMetadata | None) -> pb.ListObjectsRequest:
    """Return the request for things of a world; inverse, but for metadata: `query_from_proto`."""
    message = pb.ListObjectsRequest(
        kinds=query.kinds,
        groups=query.groups,
        names=query.names,
        instance_ids=query.instance_ids,
        after_instance_id=query.after_instance_id,
        limit=query.limit,
    )
    if query.low_m is not None:
        message.low_m.CopyFrom(_vector(query.low_m))
    if query.high_m is not None:
        message.high_m.CopyFrom(_vector(query.high_m))
    if metadata is not None:
        message.metadata.CopyFrom(metadata_to_proto(metadata))
    return message


def query_from_proto(message: pb.ListObjectsRequest) -> ObjectQuery:
    """Return which things are asked for."""
    return ObjectQuery(
        kinds=names(message.kinds, "kinds"),
        groups=names(message.groups, "groups"),
        names=names(message.names, "names"),
        instance_ids=tuple(message.instance_ids),
        low_m=_triple(message.low_m) if message.HasField("low_m") else None,
        high_m=_triple(message.high_m) if message.HasField("high_m") else None,
        after_instance_id=message.after_instance_id,
        limit=message.limit or ObjectQuery.limit,
    )


def page_to_proto(page: ObjectPage) -> pb.ListObjectsResponse:
    """Return the message of things of a world; inverse: `page_from_proto`."""
    return pb.ListObjectsResponse(
        objects=map(_object_to_proto, page.objects),
        total=page.total,
        next_after_instance_id=page.next_after_instance_id,
    )


def page_from_proto(message: pb.ListObjectsResponse) -> ObjectPage:
    """Return things of a world."""
    objects = tuple(map(_object_from_proto, message.objects))
    return ObjectPage(objects, message.total, message.next_after_instance_id)


def _object_to_proto(thing: SceneObject) -> pb.SceneObject:
    return pb.SceneObject(
        instance_id=thing.instance_id,
        name=thing.name,
        kind=thing.kind,
        group=thing.group,
        label=thing.label,
        semantic_id=thing.semantic_id,
        pose=pose_to_proto(thing.pose),
        scale=thing.scale,
        low_m=_vector(thing.low_m),
        high_m=_vector(thing.high_m),
    )


def _object_from_proto(message: pb.SceneObject) -> SceneObject:
    return SceneObject(
        instance_id=message.instance_id,
        name=message.name,
        kind=message.kind,
        group=message.group,
        label=message.label,
        semantic_id=message.semantic_id,
        pose=pose_from_proto(message.pose),
        scale=message.scale,
        low_m=_triple(message.low_m),
        high_m=_triple(message.high_m),
    )


def _vector(vector: Triple) -> pb.Vector3:
    return pb.Vector3(x=vector[0], y=vector[1], z=vector[2])


def _triple(message: pb.Vector3) -> Triple:
    return message.x, message.y, message.z
