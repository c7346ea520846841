"""The placements of a scene as ray targets, static and moving ones apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oaisys_core.private.embree import blenders_embree
from oaisys_core.raycast.embree_instances import EmbreeInstanceTarget
from oaisys_core.raycast.instance_boxes import BoxInstanceTarget
from oaisys_core.raycast.prototype_meshes import PlacedPrototype, PrototypeMesh
from oaisys_core.raycast.targets.ray_target import RayTarget
from oaisys_core.raycast.triangles import TriangleTarget
from oaisys_core.scene import Scene
from oaisys_core.types import TriangleMesh

MERGED_TRIANGLES = 12_000_000
"""Without Blender's Embree, instances of at most so many triangles in total are merged into one
mesh, which rays hit ten times as fast, but which takes 0.1 GB per million triangles."""


class MergedTarget(TriangleTarget):
    """All instances of some placements as one mesh."""

    def __init__(self, placed: Sequence[PlacedPrototype]) -> None:
        super().__init__([each.merge() for each in placed])
        counts = [each.triangle_count for each in placed]
        self._first = np.cumsum([0, *counts])
        self._sizes = np.array([each.mesh.triangle_count for each in placed])

    def triangles_of(self, elements: NDArray[np.int64]) -> NDArray[np.int64]:
        """See `RayTarget`."""
        placement = np.searchsorted(self._first, elements, side="right") - 1
        return np.asarray((elements - self._first[placement]) % self._sizes[placement])


class PlacementTargets:
    """Keeps targets of static and of moving placements, so that motion rebuilds only the latter.

    A placement that is replaced during a batch counts as moving from then on.
    """

    def __init__(self, scene: Scene) -> None:
        self._embree = blenders_embree()
        self._meshes: dict[int, PrototypeMesh] = {}
        self._static: list[PlacedPrototype] = []
        self._static_targets: list[RayTarget] = []
        self._cover_targets: list[RayTarget] = []
        self._merged: MergedTarget | None = None
        self._moving: list[PlacedPrototype] = []
        self._moving_targets: list[RayTarget] = []
        self.start_batch(scene)

    def start_batch(self, scene: Scene) -> None:
        """Take over the placements of a new batch; those not marked as moving count as static."""
        still = [each for each in self._place(scene) if not each.placement.is_moving]
        if not _are_same(still, self._static):
            self._static = still
            self._static_targets = self._targets_of(still)
        self.update(scene)

    def prepare(self) -> None:
        """Build the merged mesh's structure now, so that the first view need not wait for it."""
        if self._merged is not None:
            self._merged.prepare()

    @property
    def targets(self) -> list[RayTarget]:
        """The ray targets of all placements."""
        return [*self._static_targets, *self._moving_targets]

    def update(self, scene: Scene) -> None:
        """Take over the placements of a scene; what did not change costs nothing."""
        placed = self._place(scene)
        still = [each for each in self._static if any(each.is_same(now) for now in placed)]
        if len(still) < len(self._static):
            self._static = still
            self._static_targets = self._targets_of(still)
        others = [each for each in placed if not any(each.is_same(kept) for kept in still)]
        if not _are_same(others, self._moving):
            self._moving = others
            self._moving_targets = [self._instances(others)] if others else []

    @property
    def cover_targets(self) -> list[RayTarget]:
        """Those of `targets` that belong to the ground."""
        return self._cover_targets

    def meshes(self) -> list[TriangleMesh]:
        """Return the meshes of all placements on the stage, with ids per triangle."""
        placed = (*self._static, *self._moving)
        return [each.merge() for each in placed if each.placement.is_solid]

    def _targets_of(self, placed: Sequence[PlacedPrototype]) -> list[RayTarget]:
        faces = [each for each in placed if each.placement.is_rock_face]
        on_ground = [each for each in placed if each.placement.is_ground_cover]
        cover = [each for each in on_ground if not each.placement.is_rock_face]
        self._cover_targets = [self._instances(cover)] if cover else []
        of_faces = [self._instances(faces)] if faces else []
        others = [each for each in placed if not each.placement.is_ground_cover]
        return [*self._targets_of_objects(others), *of_faces, *self._cover_targets]

    def _targets_of_objects(self, placed: Sequence[PlacedPrototype]) -> list[RayTarget]:
        self._merged = None
        if not placed:
            return []
        plain = [each for each in placed if not each.mesh.textures.has_any]
        triangles = sum(each.triangle_count for each in plain)
        if self._embree is not None or not plain or triangles > MERGED_TRIANGLES:
            return [self._instances(placed)]
        self._merged = MergedTarget(plain)
        # Colours and cut-outs are looked up by instance.
        textured = [each for each in placed if each.mesh.textures.has_any]
        return [self._merged, *([self._instances(textured)] if textured else [])]

    def _instances(self, placed: Sequence[PlacedPrototype]) -> RayTarget:
        if self._embree is None:
            return BoxInstanceTarget(placed)
        return EmbreeInstanceTarget(placed, self._embree)

    def _place(self, scene: Scene) -> list[PlacedPrototype]:
        """Return the placements that have triangles; meshes of other prototypes are dropped."""
        prototypes = scene.prototypes
        self._meshes = {id(p): self._meshes.get(id(p)) or PrototypeMesh(p) for p in prototypes}
        placed = [
            PlacedPrototype(self._meshes[id(prototypes[p.prototype])], p) for p in scene.placements
        ]
        return [each for each in placed if each.triangle_count]


def _are_same(some: Sequence[PlacedPrototype], others: Sequence[PlacedPrototype]) -> bool:
    return len(some) == len(others) and all(
        one.is_same(other) for one, other in zip(some, others, strict=True)
    )
