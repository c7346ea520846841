"""The ground beyond a stage, which backends render and cast rays at: its triangles and heights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.procedural.terrain.surroundings.horizon import HorizonView, range_of
from oaisys_core.procedural.terrain.surroundings.land_detail import LandReliefPattern
from oaisys_core.raycast.far_ground import far_triangles
from oaisys_core.scene import Ground
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.types import FloatArray


@dataclass(frozen=True, eq=False)
class FarGroundMesh:
    """The ground from a stage's edge to the horizon; it depends on the world alone.

    Attributes:
        stage: The ground that it surrounds, without the detail near the cameras.
        vertices_m: (V, 3) float32 in ``map``.
        triangles: (T, 3) int32, as they are rendered.
        inner_share: Distance of the innermost vertices from the stage's centre, in units of the
            distance of its edge.
        level_m: Height of an infinite level plane that rays meet instead of the last triangles;
            None for land, which ends beyond the horizon.
        cast_triangles: Number of triangles that rays meet.
        detail: Relief below the triangles' size, which only light sees; None for none.
    """

    stage: Ground
    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]
    inner_share: float
    level_m: float | None
    cast_triangles: int
    detail: LandReliefPattern | None = None

    @property
    def is_land(self) -> bool:
        """Whether it is land, which has heights and is curved, rather than a level plain."""
        return self.level_m is None

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) heights of the land at (N, 2) points; NaN on the stage and without land."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        height_m = np.full(len(xy), np.nan)
        x0, y0, x1, y1 = self.stage.extent_m
        beyond = ((xy < (x0, y0)) | (xy > (x1, y1))).any(axis=1)
        if self.is_land and beyond.any():
            height_m[beyond] = far_triangles(self).surface_height_m(xy[beyond])
        return height_m

    def horizon_rad(self, azimuth_rad: float) -> float:
        """Return its elevation in a direction, as half of the stage sees it at least."""
        return float(self._horizon_rad[range_of(azimuth_rad)])

    @cached_property
    def _horizon_rad(self) -> FloatArray:
        vertices_m = self.vertices_m.astype(np.float64)
        return HorizonView(self.stage, vertices_m[:, :2]).elevations_rad(vertices_m[:, 2])


@dataclass(frozen=True)
class GroundAround:
    """The surface of a stage and of the land around it, as one."""

    stage: Ground
    land: FarGround

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the stage."""
        return self.stage.extent_m

    @property
    def spacing_m(self) -> float:
        """Typical distance between neighbouring vertices of the stage."""
        return self.stage.spacing_m

    def vertices_m(self) -> NDArray[np.float32]:
        """Return the (V, 3) vertices of the stage."""
        return self.stage.vertices_m()

    def triangles(self) -> NDArray[np.int32]:
        """Return the (T, 3) triangles of the stage."""
        return self.stage.triangles()

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) heights at (N, 2) points, on the stage or beyond."""
        on_stage_m = self.stage.height_at(xy_m)
        return np.where(np.isnan(on_stage_m), self.land.height_at(xy_m), on_stage_m)


def with_land(stage: Ground, land: FarGround | None) -> Ground:
    """Return the surface of a stage and of the land around it, if there is any."""
    return stage if land is None else GroundAround(stage, land)
