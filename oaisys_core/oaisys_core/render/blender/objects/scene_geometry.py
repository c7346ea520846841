"""The ground, what lies beyond it, and the objects of a scene in Blender."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from oaisys_core.procedural.contact_map import MAX_TRACKS, contact_map, has_rim, stage_ground
from oaisys_core.render.blender.materials.contact import DRIVEN
from oaisys_core.render.blender.materials.ground.albedo import GroundAlbedo
from oaisys_core.render.blender.materials.ground.material import GroundMaterials
from oaisys_core.render.blender.materials.images import ImageStore, purge_orphans
from oaisys_core.render.blender.objects.meshes import (
    GroundMeshes,
    new_mesh,
    new_object,
    triangles_of,
)
from oaisys_core.render.blender.objects.scene_objects import SceneObjects
from oaisys_core.scene import Scene, stands_on
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.types import TriangleMesh

FAR_GROUND = "far_ground"
"""Name of the object and mesh of the ground beyond the stage."""


class SceneGeometry:
    """All geometry in Blender's scene; sun and sky are in `objects.sky`.

    Attributes:
        ground_albedo: The albedo of the ground that was built last.
        images: Images of texture sets, and their levels of detail.
    """

    ground_albedo: GroundAlbedo
    _materials: GroundMaterials

    def __init__(self) -> None:
        self.images = ImageStore()
        self._ground: Any = None
        self._ground_meshes = GroundMeshes()
        self._far_ground = FarGroundObject()
        self._scene: Scene | None = None
        self._objects = SceneObjects(self.images)
        self._rims_of: tuple[object, ...] | None = None
        self._driven: list[float] = []

    def clear(self, scene: Scene) -> bool:
        """Remove all objects, and the ground unless ``scene`` has the same; return if it stays.

        Cycles must have been freed.
        """
        self.images.forget_cycles()
        self._objects.clear()
        if self._ground is None:
            return False
        stays = stands_on(self._scene, scene)
        if not stays:
            self._remove_ground()
        return stays

    def build_ground(self, scene: Scene) -> None:
        """Build the ground and what lies beyond it, unless they were kept."""
        self._scene = scene
        if self._ground is None:
            mesh = self._ground_meshes.make(scene.ground)
            self._materials = GroundMaterials(scene.material, self.images, bool(scene.tracks))
            mesh.materials.append(self._materials.stage)
            self.ground_albedo = GroundAlbedo(scene.material, self.images)
            self._ground = new_object("ground", mesh, np.eye(4))
            self._rims_of, self._driven = None, []
        self._show_contact(scene)
        self._far_ground.show(scene.far_ground, self._materials)

    def build_objects(self, scene: Scene) -> None:
        """Build the objects, then remove unused data."""
        self._objects.update(scene)
        purge_orphans()

    def update(self, scene: Scene) -> bool:
        """Take over what a sample changed, and return whether the ground changed."""
        before = self._scene
        if before is None:
            return False
        is_new_ground = scene.ground is not before.ground
        if is_new_ground and scene.material is before.material:
            self._reshape_ground(scene)
        elif scene.material is not before.material:
            self._remove_ground()
        self.build_ground(scene)
        self._objects.update(scene)
        parts = ("material", "prototypes", "primitives")
        if any(getattr(scene, part) is not getattr(before, part) for part in parts):
            purge_orphans()
        return is_new_ground

    def ground_mesh(self) -> TriangleMesh:
        """Return the ground as rendered, without ids."""
        return triangles_of(self._ground.data)

    def _show_contact(self, scene: Scene) -> None:
        """Show fines around the scene's things, if these are others than before."""
        placed = [(scene.prototypes[p.prototype], p) for p in scene.placements]
        ground = stage_ground(scene)
        things = [part for each in placed if has_rim(*each) for part in each]
        rims_of = (ground, *things, *(track.way_m for track in scene.tracks))
        before = self._rims_of
        if before is None or [*map(id, rims_of)] != [*map(id, before)]:
            contact = contact_map(scene)
            self._materials.show_contact(contact)
            self.ground_albedo.contact = contact
            self._rims_of = rims_of
        if scene.tracks:
            driven = [0.0] * MAX_TRACKS
            for index, track in enumerate(scene.tracks[:MAX_TRACKS]):
                driven[index] = track.driven_share
            if self._driven != driven:
                self._ground[DRIVEN] = self._driven = driven
                self._ground.update_tag()

    def _reshape_ground(self, scene: Scene) -> None:
        """Replace the ground's mesh; its material and that of the land around it stay."""
        old = self._ground.data
        mesh = self._ground_meshes.make(scene.ground)
        mesh.materials.append(old.materials[0])
        self._ground.data = mesh
        bpy.data.meshes.remove(old)

    def _remove_ground(self) -> None:
        bpy.data.batch_remove([self._ground])
        self._ground = None
        self._far_ground.clear()


class FarGroundObject:
    """The ground beyond the stage."""

    def __init__(self) -> None:
        self._thing: Any = None
        self._shown: FarGround | None = None

    def clear(self) -> None:
        """Remove it; it may also use the stage's material."""
        if self._thing is not None:
            bpy.data.meshes.remove(self._thing.data)
        self._thing = self._shown = None

    def show(self, far_ground: FarGround | None, materials: GroundMaterials) -> None:
        """Show it in renders; None hides it."""
        if far_ground is not None and far_ground is not self._shown:
            self.clear()
            mesh = new_mesh(FAR_GROUND, far_ground.vertices_m, far_ground.triangles, smooth=True)
            mesh.materials.append(materials.around_stage(far_ground.detail))
            self._thing = new_object(FAR_GROUND, mesh, np.eye(4))
            self._shown = far_ground
        is_hidden = far_ground is None
        # Assigning even the same value marks the scene as changed.
        if self._thing is not None and self._thing.hide_render != is_hidden:
            self._thing.hide_render = is_hidden
