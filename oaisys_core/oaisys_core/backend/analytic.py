"""The backend without Blender: exact depth and labels in milliseconds, and simply shaded colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import oaisys_core
from oaisys_core.backend.base import Backend, ProgressCallback, RenderSettings
from oaisys_core.backend.shading import Palette, shaded
from oaisys_core.backend.solids import flat_ground
from oaisys_core.backend.surface import (
    Surface,
    frame_of,
    frames_of,
    ground_mesh,
    placed,
)
from oaisys_core.errors import NotReadyError
from oaisys_core.scene import PlacedCamera, Scene, Sky
from oaisys_core.types import RGB, FloatArray, Frame, Progress, TriangleMesh


class AnalyticBackend(Backend):
    """Casts rays at the scene itself: closed forms where there are some, else its triangles.

    Colour has no textures and no shadows: Lambert's law under sun and sky, with the mean colour
    of each texture. Quality, samples and bounces do not matter to it; exposure does.
    """

    name = "analytic"

    def __init__(self) -> None:
        self._surface: Surface | None = None
        self._palette: Palette | None = None
        self._sky: Sky | None = None

    @property
    def version(self) -> str:
        """The package's version."""
        return oaisys_core.__version__

    def build(self, scene: Scene, progress: ProgressCallback) -> None:
        """Replace the world by ``scene``."""
        self.close()
        progress(Progress("objects", 0.0))
        objects = placed_objects(scene)
        progress(Progress("ground", 0.3))
        ground = None if flat_ground(scene.ground) else ground_mesh(scene)
        surface = Surface(scene, ground, objects)
        progress(Progress("colours", 0.9))
        self._palette = Palette(scene)
        self._surface, self._sky = surface, scene.sky

    def update(self, scene: Scene) -> None:
        """See `Backend.update`."""
        self._sky = scene.sky

    def render(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
    ) -> tuple[Frame, ...]:
        """See `Backend.render`."""
        surface, palette, sky = self._built()
        frames: list[Frame] = []
        for index, camera in enumerate(cameras):
            progress(Progress("rays", index / len(cameras)))
            view = surface.view(camera)
            by_modality = frames_of(surface, view, camera, sky)
            if RGB in camera.modalities:
                image = shaded(view, surface.normals(view), palette, sky, settings.exposure_ev)
                by_modality[RGB] = frame_of(camera, RGB, image)
            frames.extend(by_modality[modality] for modality in camera.modalities)
        return tuple(frames)

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return ground, objects and tessellated solids with ids per triangle."""
        return self._built()[0].mesh()

    def surface_height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `Backend.surface_height_m`."""
        return self._built()[0].height_m(xy_m)

    def close(self) -> None:
        """Drop the world."""
        self._surface = self._palette = self._sky = None

    def _built(self) -> tuple[Surface, Palette, Sky]:
        if self._surface is None or self._palette is None or self._sky is None:
            raise NotReadyError("the analytic backend has no scene: build one first")
        return self._surface, self._palette, self._sky


def placed_objects(scene: Scene) -> list[TriangleMesh]:
    """Return one mesh per placement, with the ids of its instances."""
    meshes = []
    for placement in scene.placements:
        prototype = scene.prototypes[placement.prototype]
        mesh = TriangleMesh(prototype.vertices_m.astype(np.float64), prototype.triangles)
        meshes.append(
            placed(mesh, placement.T_map_object, placement.semantic_ids, placement.instance_ids)
        )
    return meshes
