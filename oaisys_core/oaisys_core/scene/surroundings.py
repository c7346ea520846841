"""What the ground's material and the world know of the ground beyond a stage, and may ask of it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.scene.ground import Ground
from oaisys_core.types import FloatArray


class ReliefBand(NamedTuple):
    """The relief between two wavelengths.

    Attributes:
        period_m: Edge length of the pattern's tile.
        deviation_m: Standard deviation of heights.
        complete_m: Distance from the stage's edge from which the mesh has none of these waves.
        turn_rad: Rotation of the pattern.
        start: Shift of the pattern, in tiles.
    """

    period_m: float
    deviation_m: float
    complete_m: float
    turn_rad: float
    start: tuple[float, float]


class LandDetail(Protocol):
    """Relief below the resolution of the land's mesh, which only light sees."""

    @property
    def pattern(self) -> NDArray[np.float32]:
        """(N, N) tileable heights with standard deviation 1."""

    @property
    def bands(self) -> list[ReliefBand]:
        """The bands of wavelengths, the shortest first."""


class FarGround(Protocol):
    """The ground from a stage's edge to the horizon; it depends on the world alone."""

    @property
    def stage(self) -> Ground:
        """The ground that it surrounds, without the detail near the cameras."""

    @property
    def vertices_m(self) -> NDArray[np.float32]:
        """(V, 3) in ``map``."""

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) vertex indices, as they are rendered."""

    @property
    def inner_share(self) -> float:
        """Distance of the innermost vertices from the stage's centre, in that of its edge."""

    @property
    def level_m(self) -> float | None:
        """Height of an infinite level plane that rays meet instead of the last triangles.

        It is None for land, which ends beyond the horizon.
        """

    @property
    def cast_triangles(self) -> int:
        """Number of triangles that rays meet."""

    @property
    def detail(self) -> LandDetail | None:
        """Relief below the triangles' size; None for none."""

    @property
    def is_land(self) -> bool:
        """Whether it is land, which has heights and is curved, rather than a level plain."""

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) heights of the land at (N, 2) points; NaN on the stage and without land."""

    def horizon_rad(self, azimuth_rad: float) -> float:
        """Return its elevation in a direction, as half of the stage sees it at least."""


class LandMasks(Protocol):
    """Weights of layers around a stage, over direction and logarithm of the distance."""

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the stage."""

    @property
    def patch_m(self) -> float:
        """Size of the stage's patches."""

    @property
    def centre_m(self) -> tuple[float, float]:
        """Centre of the stage."""

    @property
    def half_m(self) -> tuple[float, float]:
        """Distances of the stage's edges from its centre, in x and in y."""

    @property
    def nearest_m(self) -> float:
        """Distance of the first row from the stage's centre."""

    @property
    def rows(self) -> int:
        """Number of rows."""

    @property
    def rows_per_e_fold(self) -> float:
        """Rows within which the distance grows by a factor of e."""

    @property
    def weights(self) -> NDArray[np.float32]:
        """(L, rows, directions) weights that sum to 1."""

    def texels_at(self, xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return columns and rows, as fractions, at (..., 2) points; columns wrap around."""

    def share_at(self, xy_m: FloatArray) -> FloatArray:
        """Return (...) weights of these masks over the stage's, mirrored, at (..., 2) points."""

    def blend(self, xy_m: FloatArray, weights: FloatArray) -> FloatArray:
        """Return (N, L) weights at (N, 2) points; ``weights`` are those of the stage's masks."""


class MacroVariation(Protocol):
    """A factor on the ground's colour, on the stage and beyond, by the place in ``map``."""

    @property
    def period_m(self) -> float:
        """Distance after which the pattern repeats."""

    @property
    def share(self) -> NDArray[np.uint8]:
        """(N, N, 3) bytes: the factor's place between its bounds; row and column 0 begin at 0 m."""

    def factors_at(self, xy_m: FloatArray) -> FloatArray:
        """Return (N, 3) factors on the linear colours at (N, 2) points."""
