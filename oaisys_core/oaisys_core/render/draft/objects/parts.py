"""What shading needs of a world, kept from view to view as long as it stays the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from oaisys_core.procedural.contact_map import MAX_TRACKS, contact_map, has_rim, stage_ground
from oaisys_core.raycast.surface import Surface
from oaisys_core.render.draft.ground.ground_normals import GroundNormals
from oaisys_core.render.draft.ground.ground_texture import GroundTexture
from oaisys_core.render.draft.ground.water import WaterMirror
from oaisys_core.render.draft.light.sky_light import SkyLight
from oaisys_core.render.draft.light.visibility import SkyVisibility
from oaisys_core.render.draft.objects.object_look import ObjectLook
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import Scene, Sky

T = TypeVar("T")


class Parts:
    """Textures, objects, light and visibility of the current scene.

    Attributes:
        ground: The ground's textures.
        normals: The ground's normals.
        objects: The objects' look.
        sky: Light of the sky.
        visibility: How much of the sky the ground sees.
        water: What water mirrors.
    """

    ground: GroundTexture
    objects: ObjectLook
    sky: SkyLight
    visibility: SkyVisibility
    water: WaterMirror

    def __init__(self, store: LevelStore) -> None:
        self._store = store
        self._scene: Scene | None = None
        self._kept: dict[str, tuple[tuple[object, ...], object]] = {}
        self.normals = GroundNormals()

    def take_over(self, surface: Surface) -> None:
        """Make what the current scene needs, unless it was made of the same parts before."""
        scene = surface.scene
        if scene is self._scene:
            return
        self._scene = scene
        material, ground = scene.material, stage_ground(scene)
        self.normals.take_over(surface)
        self.ground = self._keep(
            "ground", (material,), lambda: GroundTexture(material, self._store)
        )
        objects = (scene.prototypes, *scene.placements, *scene.primitives, material, ground)
        self.objects = self._keep("objects", objects, lambda: self._objects(scene))
        still = [each for each in scene.placements if not each.is_moving]
        self.visibility = self._keep(
            "visibility", (ground, *still, *scene.primitives), lambda: SkyVisibility(surface)
        )
        self.water = self._keep("water", objects, lambda: WaterMirror(scene))
        self._show_contact(scene)
        self.sky = self._keep("sky", (scene.sky,), lambda: SkyLight(scene.sky))

    def _objects(self, scene: Scene) -> ObjectLook:
        """Return the look of the objects; textures and meshes of before are kept."""
        _, before = self._kept.get("objects", ((), None))
        if not isinstance(before, ObjectLook):
            return ObjectLook(scene, self._store, self.ground)
        before.update(scene, self.ground)
        return before

    def _show_contact(self, scene: Scene) -> None:
        placed = [(scene.prototypes[p.prototype], p) for p in scene.placements]
        things = [part for each in placed if has_rim(*each) for part in each]
        tracks = [track.way_m for track in scene.tracks]
        rims_of = (stage_ground(scene), *things, *tracks)
        self.ground.contact = self._keep("contact", rims_of, lambda: contact_map(scene))
        driven = [track.driven_share for track in scene.tracks[:MAX_TRACKS]]
        self.ground.driven = tuple(driven)

    def _keep(self, name: str, made_of: tuple[object, ...], make: Callable[[], T]) -> T:
        """Return what was made of the same objects before, or else make it."""
        before, made = self._kept.get(name, (None, None))
        if before is None or not _are_same(before, made_of):
            made = make()
            self._kept[name] = (made_of, made)
        return cast("T", made)


def _are_same(some: tuple[object, ...], others: tuple[object, ...]) -> bool:
    return len(some) == len(others) and all(
        one is other or (isinstance(one, Sky) and one == other)
        for one, other in zip(some, others, strict=True)
    )
