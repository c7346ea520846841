"""Many instances of one mesh as a single Blender object, by geometry nodes.

Each vertex of the object's mesh is an instance, whose rotation and scale are vertex attributes.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oaisys_core.render.shading.ground_contact import GroundContact
from oaisys_core.scene import Placement
from oaisys_core.types import FloatArray

SIZE = "size"
"""Attribute of an instance, or property of an object, with its scale, which materials read."""

ROTATION = "turned"
"""Attribute with an instance's quaternion."""

ID = "instance_id"
"""Attribute of an instance, or property of an object, with its id, see `ids_to_floats`."""

BED = "bed"
"""Attribute of an instance, or property of an object: see `GroundContact.bed`."""

DUST = "dust"
"""Attribute of an instance, or property of an object: see `GroundContact.dust`."""

NODES = "instances"
"""Name of the node group."""


class InstancedMesh:
    """One mesh at many poses."""

    def __init__(
        self, name: str, mesh: Any, placement: Placement, contact: GroundContact | None
    ) -> None:
        """Show a Blender mesh at a placement's poses; see `place` for ``contact``."""
        # Not linked to the scene: only its instances are visible.
        self._original = bpy.data.objects.new(f"{name}_original", mesh)
        points = bpy.data.meshes.new(f"{name}_points")
        points.vertices.add(len(placement.instance_ids))
        points.attributes.new(ROTATION, "QUATERNION", "POINT")
        points.attributes.new(SIZE, "FLOAT", "POINT")
        if contact is not None:
            points.attributes.new(BED, "FLOAT_VECTOR", "POINT")
            points.attributes.new(DUST, "FLOAT_VECTOR", "POINT")
        halves = ids_to_floats(placement.instance_ids)
        numbers = points.attributes.new(ID, "FLOAT_VECTOR", "POINT")
        numbers.data.foreach_set("vector", halves.ravel())
        self._points = points
        self.thing = bpy.data.objects.new(name, points)
        self._nodes = _node_group(self._original)
        modifier = self.thing.modifiers.new(NODES, "NODES")
        modifier.node_group = self._nodes
        bpy.context.scene.collection.objects.link(self.thing)
        self.place(placement.T_map_object, contact)

    def place(self, T_map_object: FloatArray, contact: GroundContact | None) -> None:
        """Move the instances to (N, 4, 4) poses, with their contact if dust lies on them."""
        size = np.linalg.norm(T_map_object[:, :3, 0], axis=1)
        rotation = Rotation.from_matrix(T_map_object[:, :3, :3] / size[:, None, None])
        wxyz = rotation.as_quat(canonical=True)[:, (3, 0, 1, 2)]
        points: Any = self._points
        positions = np.ascontiguousarray(T_map_object[:, :3, 3], dtype=np.float32)
        points.vertices.foreach_set("co", positions.ravel())
        attributes = points.attributes
        attributes[ROTATION].data.foreach_set("value", wxyz.astype(np.float32).ravel())
        attributes[SIZE].data.foreach_set("value", size.astype(np.float32))
        if contact is not None:
            attributes[BED].data.foreach_set("vector", contact.bed.ravel())
            attributes[DUST].data.foreach_set("vector", contact.dust.ravel())
        points.update()
        self.thing.update_tag()

    def remove(self) -> None:
        """Remove the object from Blender; the mesh stays."""
        bpy.data.batch_remove([self.thing, self._original, self._points, self._nodes])


def ids_to_floats(instance_ids: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Return (N, 3) lower 16 bits, upper 16 bits and 0 of (N,) ids, as floats hold 24 bits exactly.

    Inverse: `ids_from_floats`.
    """
    halves = np.zeros((len(instance_ids), 3), np.float32)
    halves[:, 0], halves[:, 1] = instance_ids & 0xFFFF, instance_ids >> 16
    return halves


def ids_from_floats(halves: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return (...) ids of their (..., 2) lower and upper 16 bits; see `ids_to_floats`."""
    low, high = np.moveaxis(halves.astype(np.uint32), -1, 0)
    return np.asarray(high << np.uint32(16) | low)


def _node_group(original: Any) -> Any:
    """Return a geometry node group that puts an instance of an object on each vertex."""
    group = bpy.data.node_groups.new(NODES, "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    nodes, links = group.nodes, group.links
    start, end = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    put: Any = nodes.new("GeometryNodeInstanceOnPoints")
    info: Any = nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = original
    links.new(start.outputs[0], put.inputs["Points"])
    links.new(info.outputs["Geometry"], put.inputs["Instance"])
    for name, kind, socket in ((ROTATION, "QUATERNION", "Rotation"), (SIZE, "FLOAT", "Scale")):
        attribute: Any = nodes.new("GeometryNodeInputNamedAttribute")
        attribute.data_type = kind
        attribute.inputs["Name"].default_value = name
        links.new(attribute.outputs["Attribute"], put.inputs[socket])
    links.new(put.outputs[0], end.inputs[0])
    return group
