"""The placements and primitives of a scene as Blender objects."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any, Protocol

import bpy
import numpy as np
from mathutils import Matrix

from oaisys_core.raycast.solids import tessellate
from oaisys_core.render.blender.materials.ground.material import GroundMaterials
from oaisys_core.render.blender.materials.images import ImageStore
from oaisys_core.render.blender.materials.mesh_materials import add_materials
from oaisys_core.render.blender.materials.plants import plant_material
from oaisys_core.render.blender.materials.surfaces import (
    color_material,
    paint_vertices,
    plain_material,
    rock_material,
)
from oaisys_core.render.blender.materials.water import water_material
from oaisys_core.render.blender.objects.instances import (
    BED,
    DUST,
    ID,
    SIZE,
    InstancedMesh,
    ids_to_floats,
)
from oaisys_core.render.blender.objects.meshes import new_mesh, new_object
from oaisys_core.render.shading.ground_contact import ContactGround, GroundContact
from oaisys_core.scene import MeshPrototype, Placement, Primitive, Scene, TerrainMaterial
from oaisys_core.types import FloatArray

INSTANCED_FROM = 64
"""A placement with so many instances is one object with geometry nodes, which is faster to build
and to render than an object for each instance."""


class BlenderInstances(Protocol):
    """The instances of one placement in Blender."""

    def place(self, T_map_object: FloatArray, contact: GroundContact | None) -> None:
        """Move the instances to (N, 4, 4) poses, with their contact if dust lies on them."""

    def remove(self) -> None:
        """Remove the instances from Blender; the mesh stays."""


class SeparateObjects:
    """One object for each instance."""

    def __init__(self, mesh: Any, placement: Placement, contact: GroundContact | None) -> None:
        self._things = [
            new_object(f"instance_{instance_id}", mesh, np.eye(4))
            for instance_id in placement.instance_ids.tolist()
        ]
        halves = ids_to_floats(placement.instance_ids).tolist()
        for thing, half in zip(self._things, halves, strict=True):
            thing[ID] = half
        self.place(placement.T_map_object, contact)

    def place(self, T_map_object: FloatArray, contact: GroundContact | None) -> None:
        """See `BlenderInstances`."""
        sizes = np.linalg.norm(T_map_object[:, :3, 0], axis=1).tolist()
        for thing, size, T in zip(self._things, sizes, T_map_object, strict=True):
            thing.matrix_world = Matrix(T)
            thing[SIZE] = size
        if contact is not None:
            for thing, bed, dust in zip(self._things, contact.bed, contact.dust, strict=True):
                thing[BED], thing[DUST] = bed.tolist(), dust.tolist()

    def remove(self) -> None:
        """See `BlenderInstances`."""
        bpy.data.batch_remove(self._things)


@dataclass
class ShownPlacement:
    """A placement, its prototype and its instances in Blender."""

    prototype: MeshPrototype
    placement: Placement
    shown: BlenderInstances

    def can_become(self, prototype: MeshPrototype, placement: Placement) -> bool:
        """Return whether another placement differs in the poses of the instances only."""
        same_ids = np.array_equal(self.placement.instance_ids, placement.instance_ids)
        return self.prototype is prototype and same_ids


class SceneObjects:
    """The placements and primitives of a scene; those that did not change are kept."""

    def __init__(self, images: ImageStore) -> None:
        self._images = images
        self._meshes: dict[int, tuple[MeshPrototype, Any]] = {}
        self._rock_materials: dict[tuple[int, float], Any] = {}
        self._of_ground: dict[int, tuple[TerrainMaterial, Any]] = {}
        self._ground: ContactGround
        self._groups: list[ShownPlacement] = []
        self._solids: list[tuple[Primitive, Any]] = []

    def clear(self) -> None:
        """Remove all objects; their meshes and materials are left to be purged."""
        for group in self._groups:
            group.shown.remove()
        bpy.data.batch_remove([thing for _, thing in self._solids])
        self._groups, self._solids = [], []
        self._keep_meshes(set())
        self._rock_materials, self._of_ground = {}, {}

    def update(self, scene: Scene) -> None:
        """Take over the objects of a scene."""
        self._update_groups(scene)
        self._update_solids(scene)

    def _update_groups(self, scene: Scene) -> None:
        self._ground = ContactGround(scene, self._images)
        placed = [(scene.prototypes[p.prototype], p) for p in scene.placements]
        left = {id(group.placement): group for group in self._groups}
        kept = {id(p): left.pop(id(p)) for _, p in placed if id(p) in left}
        groups: list[ShownPlacement] = []
        for prototype, placement in placed:
            group = kept.get(id(placement))
            if group is None or group.prototype is not prototype:
                group = self._move_or_create(prototype, placement, left)
            groups.append(group)
        for unused in left.values():
            unused.shown.remove()
        self._groups = groups
        self._keep_meshes({id(prototype) for prototype in scene.prototypes})

    def _keep_meshes(self, used: set[int]) -> None:
        """Release the meshes of all other prototypes, so that they are purged."""
        for key in self._meshes.keys() - used:
            self._meshes.pop(key)[1].use_fake_user = False

    def _move_or_create(
        self, prototype: MeshPrototype, placement: Placement, left: dict[int, ShownPlacement]
    ) -> ShownPlacement:
        contact = self._ground(placement.T_map_object) if prototype.dust_m else None
        for key, group in left.items():
            if group.can_become(prototype, placement):
                group.shown.place(placement.T_map_object, contact)
                group.placement = placement
                return left.pop(key)
        mesh = self._mesh(prototype)
        if len(placement.instance_ids) < INSTANCED_FROM:
            return ShownPlacement(prototype, placement, SeparateObjects(mesh, placement, contact))
        shown = InstancedMesh(f"instances_of_{prototype.name}", mesh, placement, contact)
        return ShownPlacement(prototype, placement, shown)

    def _update_solids(self, scene: Scene) -> None:
        left = dict(enumerate(self._solids))
        solids: list[tuple[Primitive, Any]] = []
        for primitive in scene.primitives:
            for key, (before, thing) in left.items():
                if _looks_like(before, primitive):
                    if before is not primitive:
                        thing.matrix_world = Matrix(primitive.T_map_object)
                    solids.append((primitive, thing))
                    del left[key]
                    break
            else:
                solids.append((primitive, _solid(primitive)))
        # Even removing nothing marks the scene as changed.
        if left:
            bpy.data.batch_remove([thing for _, thing in left.values()])
        self._solids = solids

    def _mesh(self, prototype: MeshPrototype) -> Any:
        if id(prototype) not in self._meshes:
            mesh = new_mesh(prototype.name, prototype.vertices_m, prototype.triangles, smooth=True)
            if prototype.crease_rad < pi:
                mesh.set_sharp_from_angle(angle=prototype.crease_rad)
            if prototype.image_materials and prototype.water is None:
                add_materials(prototype, mesh)
            else:
                mesh.materials.append(self._material(prototype, mesh))
            # Keeps the mesh while no object shows it.
            mesh.use_fake_user = True
            self._meshes[id(prototype)] = (prototype, mesh)
        return self._meshes[id(prototype)][1]

    def _material(self, prototype: MeshPrototype, mesh: Any) -> Any:
        maps = prototype.maps
        if prototype.ground is not None:
            return self._rock_of_ground(prototype.ground)
        if prototype.water is not None:
            paint_vertices(prototype, mesh, prototype.water.opacity)
            return water_material(prototype)
        if maps is None and prototype.translucency is not None:
            return plant_material(prototype, mesh)
        if maps is None:
            painted = color_material(prototype, mesh)
            return painted or plain_material(prototype.color_srgb)
        key = (id(maps), prototype.dust_m)
        if key not in self._rock_materials:
            self._rock_materials[key] = rock_material(maps, self._images, prototype.dust_m)
        return self._rock_materials[key]

    def _rock_of_ground(self, material: TerrainMaterial) -> Any:
        """Return the ground's material for rock faces, which has one layer."""
        key = id(material)
        if key not in self._of_ground:
            made = GroundMaterials(material, self._images)
            made.show_contact(None)
            made.stage.pass_index = 0
            self._of_ground[key] = (material, made.stage)
        return self._of_ground[key][1]


def _looks_like(before: Primitive, now: Primitive) -> bool:
    return (before.shape, before.size_m, before.color_srgb, before.instance_id) == (
        now.shape,
        now.size_m,
        now.color_srgb,
        now.instance_id,
    )


def _solid(primitive: Primitive) -> Any:
    triangles = tessellate(primitive)
    is_round = primitive.shape == "sphere"
    mesh = new_mesh(primitive.shape, triangles.vertices_m, triangles.triangles, smooth=is_round)
    mesh.materials.append(plain_material(primitive.color_srgb))
    thing = new_object(f"instance_{primitive.instance_id}", mesh, primitive.T_map_object)
    thing[ID] = ids_to_floats(np.array([primitive.instance_id], np.uint32))[0].tolist()
    return thing
