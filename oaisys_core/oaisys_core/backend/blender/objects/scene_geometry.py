"""The ground, the far plain and the objects of a scene in Blender."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from oaisys_core.backend.blender.materials.ground import ground_material
from oaisys_core.backend.blender.materials.ground_albedo import GroundAlbedo
from oaisys_core.backend.blender.materials.images import ImageStore
from oaisys_core.backend.blender.objects.meshes import (
    GroundMeshes,
    evaluated_mesh,
    new_mesh,
    new_object,
)
from oaisys_core.backend.blender.objects.scene_objects import SceneObjects
from oaisys_core.backend.raycast.far_plain import LEVEL, SLOPE, rings, stage_of
from oaisys_core.scene import Scene, stands_on
from oaisys_core.types import TriangleMesh

PLAIN = "plain"
"""Name of the far plain's object and mesh."""


class SceneGeometry:
    """All geometry in Blender's scene; sun and sky are in `objects.sky`.

    Attributes:
        ground_albedo: The albedo of the ground that was built last.
    """

    ground_albedo: GroundAlbedo

    def __init__(self) -> None:
        self._images = ImageStore()
        self._ground: Any = None
        self._ground_meshes = GroundMeshes()
        self._plain = FarPlainObject()
        self._scene: Scene | None = None
        self._objects = SceneObjects(self._images)

    def clear(self, scene: Scene) -> bool:
        """Remove all objects, and the ground unless ``scene`` has the same; return if it stays."""
        self._objects.clear()
        if self._ground is None:
            return False
        stays = stands_on(self._scene, scene)
        if not stays:
            self._remove_ground()
        return stays

    def build_ground(self, scene: Scene) -> None:
        """Build the ground and the far plain, unless they were kept."""
        self._scene = scene
        if self._ground is not None:
            return
        mesh = self._ground_meshes.make(scene.ground)
        mesh.materials.append(ground_material(scene.material, self._images))
        self.ground_albedo = GroundAlbedo(scene.material, self._images)
        self._ground = new_object("ground", mesh, np.eye(4))
        self._plain.build(scene, mesh.materials[0])

    def show_plain(self, is_shown: bool) -> None:
        """Show or hide the far plain."""
        self._plain.show(is_shown)

    def build_objects(self, scene: Scene) -> None:
        """Build the objects, then remove unused data."""
        self._objects.update(scene)
        self._purge()

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
        self._scene = scene
        self._objects.update(scene)
        parts = ("material", "prototypes", "primitives")
        if any(getattr(scene, part) is not getattr(before, part) for part in parts):
            self._purge()
        return is_new_ground

    def ground_mesh(self) -> TriangleMesh:
        """Return the ground as rendered, without ids."""
        return evaluated_mesh(self._ground)

    def _reshape_ground(self, scene: Scene) -> None:
        """Replace the ground's mesh; its material and the far plain stay."""
        old = self._ground.data
        mesh = self._ground_meshes.make(scene.ground)
        mesh.materials.append(old.materials[0])
        self._ground.data = mesh
        bpy.data.meshes.remove(old)

    def _remove_ground(self) -> None:
        bpy.data.batch_remove([self._ground])
        self._ground = None
        self._plain.clear()

    def _purge(self) -> None:
        bpy.data.orphans_purge(do_recursive=True)
        self._images.remove_unused()


class FarPlainObject:
    """The far plain, see `oaisys_core.backend.raycast.far_plain`, with the ground's material."""

    def __init__(self) -> None:
        self._thing: Any = None

    def clear(self) -> None:
        """Remove the far plain, which also uses the ground's material."""
        if self._thing is not None:
            bpy.data.meshes.remove(self._thing.data)
        self._thing = None

    def build(self, scene: Scene, material: Any) -> None:
        """Build the far plain around a scene's ground."""
        self.clear()
        triangles = rings(stage_of(scene.ground), (*SLOPE, *LEVEL))
        mesh = new_mesh(PLAIN, *triangles, smooth=True)
        mesh.materials.append(material)
        self._thing = new_object(PLAIN, mesh, np.eye(4))

    def show(self, is_shown: bool) -> None:
        """Show or hide it in renders."""
        # Assigning even the same value marks the scene as changed.
        if self._thing is not None and self._thing.hide_render == is_shown:
            self._thing.hide_render = not is_shown
