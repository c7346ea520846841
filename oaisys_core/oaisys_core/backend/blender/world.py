"""A scene's ground and objects as Blender's objects."""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.blender.ground import ground_material
from oaisys_core.backend.blender.images import ImageStore
from oaisys_core.backend.blender.materials import plain_material, rock_material
from oaisys_core.backend.blender.meshes import (
    evaluated_mesh,
    evaluated_poses,
    new_mesh,
    new_object,
)
from oaisys_core.backend.blender.plain import Plain
from oaisys_core.backend.solids import tessellated
from oaisys_core.backend.surface import placed
from oaisys_core.scene import MeshPrototype, Placement, Primitive, Scene
from oaisys_core.types import TriangleMesh


class Group(NamedTuple):
    """The objects of one placement."""

    things: list[Any]
    semantic_ids: tuple[int, ...]
    instance_ids: NDArray[np.uint32]


class World:
    """Everything solid in Blender's scene."""

    def __init__(self) -> None:
        self._images = ImageStore()
        self._ground: Any = None
        self._plain = Plain()
        self._ground_of: Scene | None = None
        self._groups: list[Group] = []
        self._solids: list[Any] = []

    def clear(self, scene: Scene) -> None:
        """Remove all objects, and the ground too unless ``scene`` stands on the same one."""
        bpy.data.batch_remove([thing for group in self._groups for thing in group.things])
        bpy.data.batch_remove(self._solids)
        self._groups, self._solids = [], []
        if self._ground is not None and not _same_ground(self._ground_of, scene):
            bpy.data.batch_remove([self._ground])
            self._ground = None
            self._plain.clear()

    def build_ground(self, scene: Scene) -> None:
        """Make the ground where none was kept."""
        self._ground_of = scene
        if self._ground is not None:
            return
        mesh = new_mesh("ground", scene.ground.vertices_m(), scene.ground.triangles(), smooth=True)
        mesh.materials.append(ground_material(scene.material, self._images))
        self._ground = new_object("ground", mesh, np.eye(4))
        self._plain.build(scene, mesh.materials[0])

    def show_plain(self, is_shown: bool) -> None:
        """Let the ground go on beyond the stage, or not."""
        self._plain.show(is_shown)

    def build_objects(self, scene: Scene) -> None:
        """Make all that stands on the ground, then drop what nothing uses any more."""
        materials: dict[int, Any] = {}
        meshes = [self._prototype(prototype, materials) for prototype in scene.prototypes]
        self._groups = [_group(meshes[p.prototype], p) for p in scene.placements]
        self._solids = [_solid(primitive) for primitive in scene.primitives]
        bpy.data.orphans_purge(do_recursive=True)
        self._images.remove_unused()

    def ground_mesh(self) -> TriangleMesh:
        """Return the ground as it renders, without ids."""
        return evaluated_mesh(self._ground)

    def object_meshes(self) -> list[TriangleMesh]:
        """Return the objects as they render, one mesh per placement, with ids."""
        return [
            placed(
                evaluated_mesh(group.things[0]),
                evaluated_poses(group.things),
                group.semantic_ids,
                group.instance_ids,
            )
            for group in self._groups
            if group.things
        ]

    def _prototype(self, prototype: MeshPrototype, materials: dict[int, Any]) -> Any:
        mesh = new_mesh(prototype.name, prototype.vertices_m, prototype.triangles, smooth=True)
        maps = prototype.maps
        if maps is None:
            mesh.materials.append(plain_material(prototype.color_srgb))
            return mesh
        if id(maps) not in materials:
            materials[id(maps)] = rock_material(maps, self._images)
        mesh.materials.append(materials[id(maps)])
        return mesh


def _group(mesh: Any, placement: Placement) -> Group:
    ids = placement.instance_ids
    things = [
        _instance(mesh, instance_id, T)
        for instance_id, T in zip(ids.tolist(), placement.T_map_object, strict=True)
    ]
    return Group(things, placement.semantic_ids, ids)


def _instance(mesh: Any, instance_id: int, T_map_object: NDArray[np.float64]) -> Any:
    thing = new_object(f"instance_{instance_id}", mesh, T_map_object)
    scale = float(np.linalg.norm(T_map_object[:3, 0]))
    thing.color = (scale, scale, scale, 1.0)
    return thing


def _solid(primitive: Primitive) -> Any:
    triangles = tessellated(primitive)
    is_round = primitive.shape == "sphere"
    mesh = new_mesh(primitive.shape, triangles.vertices_m, triangles.triangles, smooth=is_round)
    mesh.materials.append(plain_material(primitive.color_srgb))
    return new_object(f"instance_{primitive.instance_id}", mesh, primitive.T_map_object)


def _same_ground(old: Scene | None, new: Scene) -> bool:
    return (
        old is not None
        and bool(new.stage_hash)
        and new.stage_hash == old.stage_hash
        and new.material is old.material
    )
