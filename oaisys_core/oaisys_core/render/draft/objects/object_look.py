"""How objects look: rocks, plants, meshes from files, and exact solids."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.terrain.surroundings.far_ground import with_land
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import InstanceTable, View
from oaisys_core.render.draft.appearance import (
    Appearance,
    Floats,
    by_component,
    dot,
    normalise,
    places_m,
    put,
    take,
    zeros,
)
from oaisys_core.render.draft.ground.ground_texture import GroundTexture
from oaisys_core.render.draft.ground.water import light_below_water
from oaisys_core.render.draft.objects.mesh_hits import MeshHits, alike
from oaisys_core.render.draft.objects.object_meshes import (
    Instances,
    ObjectMeshes,
    to_map,
    to_objects,
)
from oaisys_core.render.draft.objects.rock_texture import RockTexture
from oaisys_core.render.shading.ground_contact import ContactGround
from oaisys_core.render.shading.looks import (
    CONTACT,
    CONTACT_SHARE,
    DUST_ON_TOP,
    MAX_DUST,
    OBJECT_ROUGHNESS,
    PLANT_TINTS,
    ROCK_BRIGHTNESS,
)
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import MeshPrototype, PbrMaps, Scene, TerrainMaterial
from oaisys_core.types import FloatArray

RandomNumbers = Callable[[NDArray[np.uint32]], Floats]
"""Returns the (N,) numbers from 0 to 1 of instances, by which their brightness differs."""


def hash_numbers(instance_ids: NDArray[np.uint32]) -> Floats:
    """Return (N,) numbers from 0 to 1 that are the same in each view."""
    mixed = instance_ids * np.uint32(0x9E3779B1)
    for shift, factor in ((15, 0x2C1B3C6D), (12, 0x297A2D39), (15, 1)):
        mixed = (mixed ^ (mixed >> np.uint32(shift))) * np.uint32(factor)
    return (mixed * 2.0**-32).astype(np.float32)


class ObjectLook:
    """Looks up how objects look.

    Attributes:
        random_numbers: By which the brightness of instances differs.
    """

    random_numbers: RandomNumbers = staticmethod(hash_numbers)

    def __init__(self, scene: Scene, store: LevelStore, ground: GroundTexture) -> None:
        """Take over a scene, whose ground has such a texture."""
        self._store = store
        self._textures: dict[int, RockTexture] = {}
        self._faces: dict[int, tuple[TerrainMaterial, GroundTexture]] = {}
        self._meshes_of: tuple[MeshPrototype, ...] | None = None
        self.update(scene, ground)

    def update(self, scene: Scene, ground: GroundTexture) -> None:
        """Take over a changed scene; what did not change is kept."""
        self._scene, self._ground = scene, ground
        self._below = light_below_water(scene.sky)
        self._all_ground = with_land(scene.ground, scene.far_ground)
        if self._meshes_of is not scene.prototypes:
            self._meshes_of = scene.prototypes
            used = {id(each.ground) for each in scene.prototypes}
            self._faces = {key: kept for key, kept in self._faces.items() if key in used}
            self._meshes = ObjectMeshes(scene.prototypes)
            self._dust_m = np.array([each.dust_m or 0 for each in scene.prototypes], np.float32)
            self._groups, self._kinds = alike(scene.prototypes)
        self._instances = Instances(scene)
        self._solids = InstanceTable(
            scene,
            [np.zeros(3)] * len(scene.placements),
            [linear(each.color_srgb) for each in scene.primitives],
            np.float32,
        )
        self._contact_of: tuple[Floats, Floats] | None = None

    def at(self, surface: Surface, view: View, footprint_m: Floats) -> Appearance:
        """Return how the points of a view of one column look, all of which are on objects.

        Args:
            surface: Which the rays of the view were cast at.
            view: N rays.
            footprint_m: (N,) sizes of a pixel there.
        """
        ids = view.instance_ids[:, 0]
        place = self._instances.find(ids)
        count = len(ids)
        look = Appearance(
            zeros(count, 3),
            zeros(count, 3),
            zeros(count, 3),
            np.full(count, OBJECT_ROUGHNESS, np.float32),
            np.zeros(count, np.float32),
        )
        solid = np.flatnonzero(place < 0)
        if len(solid):
            normal = by_component(surface.normals(view.rows(solid))[:, 0])
            for into, values in zip(look, (self._solids(ids[solid]), normal, normal), strict=False):
                put(into, solid, values)
        meshes = np.flatnonzero(place >= 0)
        if len(meshes):
            self._add_meshes(surface, view.rows(meshes), meshes, place, footprint_m, look)
        return look

    def _add_meshes(
        self,
        surface: Surface,
        view: View,
        rows: NDArray[np.intp],
        places: NDArray[np.intp],
        footprint_m: Floats,
        look: Appearance,
    ) -> None:
        """Write, into ``rows``, how points on meshes look."""
        hits = self._hits(surface, view, places[rows], footprint_m[rows])
        color, roughness = hits.color.copy(order="K"), look.roughness[rows]
        normal, through = hits.normal.copy(order="K"), hits.through.copy()
        groups = self._groups.take(hits.prototype)
        for group in np.flatnonzero(np.bincount(groups)).tolist():
            kind = self._kinds[group]
            at = np.flatnonzero(groups == group)
            some = hits if len(at) == len(groups) else hits.take(at)
            if kind.water is not None:
                bottom = self._bottom(view.points_m[at, 0], some)
                opacity = some.through[:, None]
                put(color, at, opacity * some.color + self._below * (1 - opacity) * bottom)
                through[at] = 0
            elif kind.maps is not None:
                rock = (
                    self._rock(kind.maps, some, has_dust=bool(kind.dust_m))
                    if kind.ground is None
                    else self._rock_face(kind.ground, view.points_m[at, 0], some)
                )
                for values, found in zip((color, normal, roughness), rock, strict=True):
                    put(values, at, found)
            elif kind.translucency is not None:
                least, most = np.array(PLANT_TINTS, np.float32)
                put(color, at, some.color * (least + (most - least) * some.random[:, None]))
            elif kind.vertex_colors_srgb is None:
                color[at] = linear(kind.color_srgb)
            elif kind.dust_m:
                half = np.full(len(at), 0.5, np.float32)
                put(color, at, self._with_dust(some, half, some.color))
        own = surface.own_albedo(view)
        if own is not None:
            color = np.where(np.isnan(own[:, 0]), color, own[:, 0]).astype(np.float32)
        for into, values in zip(
            look, (color, normal, hits.normal, roughness, through), strict=True
        ):
            put(into, rows, values)

    def _hits(
        self,
        surface: Surface,
        view: View,
        place: NDArray[np.intp],
        footprint_m: Floats,
    ) -> MeshHits:
        instances = self._instances
        prototype = instances.prototypes[place]
        points_m = places_m(view.points_m[:, 0])
        offset_m = (points_m - take(instances.positions_m, place)).astype(np.float32)
        R = take(instances.rotations, place)
        local_m = to_objects(R, offset_m)
        triangles = self._meshes.first_triangle[prototype] + surface.triangles_of(view)
        found = self._meshes.at(triangles, local_m / instances.scale.take(place)[:, None])
        normal = normalise(to_map(R, found.normal))
        is_back = dot(to_map(R, found.face), by_component(view.directions[:, 0])) > 0
        # Leaves are seen from both sides.
        normal *= np.where(is_back, np.float32(-1), np.float32(1))[:, None]
        random = self.random_numbers(instances.ids[place])
        return MeshHits(
            place,
            prototype,
            offset_m,
            local_m,
            R,
            normal,
            found.color,
            found.through,
            random,
            footprint_m,
        )

    def _bottom(self, points_m: FloatArray, hits: MeshHits) -> Floats:
        """Return the (N, 3) albedo of the ground below points of water."""
        low_m = points_m.copy()
        low_m[:, 2] = self._all_ground.height_at(points_m[:, :2])
        return self._ground.at(np.nan_to_num(low_m), hits.normal, hits.footprint_m).albedo

    def _rock(
        self, maps: PbrMaps, hits: MeshHits, *, has_dust: bool
    ) -> tuple[Floats, Floats, Floats]:
        """Return colours, normals and roughness of points on rocks."""
        if id(maps) not in self._textures:
            self._textures[id(maps)] = RockTexture(maps, self._store)
        place_m = hits.local_m + take(self._instances.positions_m, hits.place)
        local = to_objects(hits.R, hits.normal)
        found = self._textures[id(maps)].at(place_m, local, hits.footprint_m)
        least, range_ = ROCK_BRIGHTNESS
        color = found.color * (least + range_ * hits.random)[:, None]
        if has_dust:
            color = self._with_dust(hits, found.height, color)
        slope = to_map(hits.R, found.slope)
        along = dot(slope, hits.normal)[:, None] * hits.normal
        return color, normalise(hits.normal - slope + along), found.roughness

    def _rock_face(
        self, material: TerrainMaterial, points_m: FloatArray, hits: MeshHits
    ) -> tuple[Floats, Floats, Floats]:
        """Return what `_rock` does, of the rock of a ground."""
        if id(material) not in self._faces:
            self._faces[id(material)] = material, GroundTexture(material, self._store)
        texture = self._faces[id(material)][1]
        found = texture.at(places_m(points_m), hits.normal, hits.footprint_m)
        return found.albedo, found.normal, found.roughness

    def _with_dust(self, hits: MeshHits, height: Floats, color: Floats) -> Floats:
        """Return colours under the ground's dust, see `materials.contact` of Blender's backend."""
        bed, dust = self._contact(hits.place)
        above_m = hits.offset_m[:, 2] - bed[:, 2]
        above_m -= hits.offset_m[:, 0] * bed[:, 0] + hits.offset_m[:, 1] * bed[:, 1]
        full_m = self._instances.scale.take(hits.place) * self._dust_m.take(hits.prototype)
        share = above_m / full_m
        foot = np.clip(1 - share * (height * np.float32(1.4) + np.float32(0.4)), 0, 1)
        top = np.clip(hits.normal[:, 2] * 2 - np.float32(1.3), 0, 1)
        cover = np.maximum(foot * np.float32(MAX_DUST), top * np.float32(DUST_ON_TOP))
        uneven = dust * (height * np.float32(0.5) + np.float32(0.7))[:, None]
        dusty = color + cover[:, None] * (uneven - color)
        dark = np.clip(share * ((1 - CONTACT) / CONTACT_SHARE) + CONTACT, 0, 1)
        return np.asarray(dusty * dark[:, None], np.float32)

    def _contact(self, place: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return the (N, 3) beds and dust of instances, see `GroundContact`."""
        if self._contact_of is None:
            ground = ContactGround(self._scene, self._store)
            beds, dusts = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.float32)]
            for placement in self._scene.placements:
                if self._scene.prototypes[placement.prototype].dust_m:
                    found = ground(placement.T_map_object)
                    beds.append(found.bed)
                    dusts.append(found.dust)
                else:
                    beds.append(np.zeros((len(placement.instance_ids), 3), np.float32))
                    dusts.append(beds[-1])
            order = self._instances.order
            beds_of, dusts_of = (
                by_component(np.concatenate(each)[order]) for each in (beds, dusts)
            )
            self._contact_of = beds_of, dusts_of
        return take(self._contact_of[0], place), take(self._contact_of[1], place)
