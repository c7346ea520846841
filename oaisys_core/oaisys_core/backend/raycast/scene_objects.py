"""The objects of a scene as rays meet them: those that stay and those that move, apart."""

from __future__ import annotations

from collections.abc import Sequence

from oaisys_core.backend.raycast.embree import blenders_embree
from oaisys_core.backend.raycast.instance_arrays import Shapes, Standing
from oaisys_core.backend.raycast.instances import InstanceCaster
from oaisys_core.backend.raycast.ray_targets import InstancePart, Part, TrianglePart
from oaisys_core.backend.raycast.triangles import RayCaster
from oaisys_core.scene import Scene
from oaisys_core.types import TriangleMesh

MERGED_TRIANGLES = 12_000_000
"""Triangles up to which one structure over copies of all instances is taken, where there is no
Embree that knows instances.

It is ten times as fast to cast at as boxes and more, but takes 0.7 s and 0.1 GB per million
triangles to build (two cores): 100,000 pebbles of 80 triangles take 6 s and 0.8 GB, as boxes 0.6 s
and 0.1 GB.
"""


class Objects:
    """Placements, in two groups, so that what moves does not cost a new structure over all.

    A placement that was replaced or removed since the batch began is held to move from then on.
    """

    def __init__(self, scene: Scene) -> None:
        self._embree = blenders_embree()
        self._shapes = Shapes()
        self._still: list[Standing] = []
        self._still_parts: list[Part] = []
        self._unprepared: RayCaster | None = None
        self._others: list[Standing] = []
        self._other_parts: list[Part] = []
        self.begin_again(scene)

    def begin_again(self, scene: Scene) -> None:
        """Take over a batch's placements: those that do not move are held to stand still."""
        still = [each for each in _standing(scene) if not each.placement.is_moving]
        if not _are_same(still, self._still):
            self._still = still
            self._still_parts = self._parts_of(still)
        self.update(scene)

    def prepare(self) -> None:
        """Build now what the first view would wait for: 0.7 s per million triangles."""
        if self._unprepared is not None:
            self._unprepared.prepare()

    @property
    def parts(self) -> list[Part]:
        """Everything that rays can meet."""
        return [*self._still_parts, *self._other_parts]

    def update(self, scene: Scene) -> None:
        """Take over the placements of a scene; those that are the same objects cost nothing."""
        standing = _standing(scene)
        still = [each for each in self._still if any(each.is_same(now) for now in standing)]
        if len(still) < len(self._still):
            self._still = still
            self._still_parts = self._parts_of(still)
        others = [each for each in standing if not any(each.is_same(kept) for kept in still)]
        if not _are_same(others, self._others):
            self._others = others
            self._other_parts = [self._instances(others)]
        self._shapes.keep_only(scene.prototypes)

    def meshes(self) -> list[TriangleMesh]:
        """Return the triangles of all placements, with ids."""
        return [each.mesh() for each in (*self._still, *self._others)]

    def _parts_of(self, standing: Sequence[Standing]) -> list[Part]:
        self._unprepared = None
        if not standing:
            return []
        triangles = sum(each.triangle_count for each in standing)
        if self._embree is None and triangles <= MERGED_TRIANGLES:
            self._unprepared = RayCaster([each.mesh() for each in standing])
            return [TrianglePart(self._unprepared)]
        return [self._instances(standing)]

    def _instances(self, standing: Sequence[Standing]) -> Part:
        return InstancePart(InstanceCaster(standing, self._shapes, self._embree))


def _are_same(some: Sequence[Standing], others: Sequence[Standing]) -> bool:
    return len(some) == len(others) and all(
        one.is_same(other) for one, other in zip(some, others, strict=True)
    )


def _standing(scene: Scene) -> list[Standing]:
    return [Standing(scene.prototypes[p.prototype], p) for p in scene.placements]
