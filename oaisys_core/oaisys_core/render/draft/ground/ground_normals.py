"""Smooth normals of the ground, interpolated as Blender interpolates those of its vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.detail import DetailedGround
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.draft.appearance import Floats, empty, normalise, put, take, zeros
from oaisys_core.render.draft.ground.texture_atlas import sample
from oaisys_core.render.draft.objects.object_meshes import interpolate_normals, vertex_normals
from oaisys_core.scene import FarGround, Ground, HeightField
from oaisys_core.types import FloatArray, TriangleMesh


class GroundNormals:
    """Normals of the stage and of the ground around it."""

    _mesh: TriangleMesh
    _normals: Floats
    _far_normals: Floats

    def __init__(self) -> None:
        self._ground: Ground | None = None
        self._grids: list[SlopeGrid] = []
        self._far_ground: FarGround | None = None

    def at(self, surface: Surface, view: View, points_m: FloatArray) -> Floats:
        """Return the (N, 3) unit normals of a view of one column, all of whose rays hit ground.

        ``points_m`` are the view's, stored component by component.
        """
        elements = view.elements[:, 0]
        far = np.flatnonzero(surface.is_far_ground(view)[:, 0])
        far_ground = surface.scene.far_ground
        if not len(far) or far_ground is None:
            return self._of_stage(points_m, elements)
        normals = empty(len(elements), 3)
        put(normals, far, self._of_far_ground(far_ground, take(points_m, far), elements[far]))
        if len(far) < len(elements):
            stage = np.flatnonzero(~surface.is_far_ground(view)[:, 0])
            put(normals, stage, self._of_stage(take(points_m, stage), elements[stage]))
        return normals

    def take_over(self, surface: Surface) -> None:
        """Prepare the normals of the current ground, unless they are known."""
        scene = surface.scene
        if scene.ground is not self._ground:
            self._take_over_stage(scene.ground)
            if not self._grids:
                mesh = surface.ground_triangles()
                self._mesh = mesh
                self._normals = vertex_normals(mesh.vertices_m, mesh.triangles)
        far_ground = scene.far_ground
        if far_ground is not None and far_ground is not self._far_ground:
            self._far_ground = far_ground
            self._far_normals = vertex_normals(far_ground.vertices_m, far_ground.triangles)

    def _take_over_stage(self, ground: Ground) -> None:
        self._ground = ground
        grids: list[HeightField] = []
        if isinstance(ground, DetailedGround):
            # Maps of normals have the relief of textures.
            grids = [ground.coarse, ground.shaded or ground.fine]
        elif isinstance(ground, HeightField):
            grids = [ground]
        kept = {id(each.ground): each for each in self._grids}
        self._grids = [kept.get(id(each)) or SlopeGrid(each) for each in grids]

    def _of_stage(self, points_m: FloatArray, elements: NDArray[np.int64]) -> Floats:
        if not self._grids:
            vertices_m, triangles = self._mesh.vertices_m, self._mesh.triangles
            return interpolate_normals(vertices_m, triangles, self._normals, elements, points_m)
        normals = self._grids[0].at(points_m)
        for grid in self._grids[1:]:
            inside = np.flatnonzero(grid.contains(points_m))
            if len(inside):
                put(normals, inside, grid.at(take(points_m, inside)))
        return normals

    def _of_far_ground(
        self, far_ground: FarGround, points_m: FloatArray, elements: NDArray[np.int64]
    ) -> Floats:
        normals = zeros(len(elements), 3)
        normals[:, 2] = 1
        rows = np.flatnonzero(elements < far_ground.cast_triangles)
        found = interpolate_normals(
            far_ground.vertices_m,
            far_ground.triangles,
            self._far_normals,
            elements[rows],
            take(points_m, rows),
        )
        put(normals, rows, found)
        return normals


class SlopeGrid:
    """The slopes of a height field at its vertices, from those beside them.

    Attributes:
        ground: The height field.
    """

    def __init__(self, ground: HeightField) -> None:
        self.ground = ground
        self._slopes = ground.slopes()

    def at(self, points_m: FloatArray) -> Floats:
        """Return the (N, 3) unit normals at (N, 3) points."""
        x, y = (
            ((place_m - start_m) / self.ground.spacing_m).astype(np.float32)
            for place_m, start_m in zip(points_m.T[:2], self.ground.origin_xy_m, strict=True)
        )
        normals = empty(len(points_m), 3)
        normals[:, 2] = 1
        np.negative(sample(self._slopes, x, y), out=normals[:, :2])
        return normalise(normals)

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) which points are on it."""
        x0, y0, x1, y1 = self.ground.extent_m
        x, y = points_m[:, 0], points_m[:, 1]
        return np.asarray((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))
