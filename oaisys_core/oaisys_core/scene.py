"""The scene of a batch: plain typed data that modules draw and backends build.

All coordinates are in ``map`` (metres, z up).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.lamps import Lamp
from oaisys_core.sky import Sky
from oaisys_core.types import (
    FLOW,
    POINTS,
    RGB,
    FloatArray,
    PinholeIntrinsics,
    ShortRepr,
    TriangleMesh,
)
from oaisys_core.world.terrain_material import PbrMaps, TerrainLayer, TerrainMaterial, id_of_level

if TYPE_CHECKING:
    from oaisys_core.terrain.surroundings.far_ground import FarGround

__all__ = [
    "Ground",
    "HeightField",
    "Lamp",
    "Lens",
    "LidarErrors",
    "MeshPrototype",
    "PbrMaps",
    "PlacedCamera",
    "PlacedLidar",
    "Placement",
    "PoseAtTime",
    "Primitive",
    "ScanPattern",
    "Scene",
    "Sky",
    "TerrainLayer",
    "TerrainMaterial",
    "WaterSurface",
    "WheelTracks",
    "id_of_level",
    "merge_meshes",
]


class Ground(Protocol):
    """The ground of a stage: one surface for rendering, labels and height queries."""

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the ground."""

    @property
    def spacing_m(self) -> float:
        """Typical distance between neighbouring vertices."""

    def vertices_m(self) -> NDArray[np.float32]:
        """Return (V, 3) float32 vertices in ``map``."""

    def triangles(self) -> NDArray[np.int32]:
        """Return (T, 3) int32 indices, counter-clockwise from above."""

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) heights of the topmost surface at (N, 2) points; NaN outside the ground."""


@dataclass(frozen=True, repr=False)
class HeightField(ShortRepr):
    """The ground as a regular grid of elevations, triangulated along one diagonal.

    The triangulation is the surface: all backends, labels and queries use it.

    Attributes:
        elevation_m: (rows, cols) float32; row i lies at y = origin + i * spacing, column j at
            x = origin + j * spacing.
        origin_xy_m: (x, y) of elevation[0, 0].
        spacing_m: Distance between neighbouring grid points.
    """

    elevation_m: NDArray[np.float32]
    origin_xy_m: tuple[float, float]
    spacing_m: float

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the ground."""
        rows, cols = self.elevation_m.shape
        x0, y0 = self.origin_xy_m
        return (x0, y0, x0 + (cols - 1) * self.spacing_m, y0 + (rows - 1) * self.spacing_m)

    def grid_m(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the (rows,) float32 y and (cols,) x of vertices."""
        rows, cols = self.elevation_m.shape
        x0, y0, x1, y1 = self.extent_m
        y_m, x_m = np.linspace(y0, y1, rows), np.linspace(x0, x1, cols)
        return y_m.astype(np.float32), x_m.astype(np.float32)

    def vertices_m(self) -> NDArray[np.float32]:
        """Return (rows * cols, 3) float32 vertices, row by row."""
        y_m, x_m = self.grid_m()
        vertices = np.empty((*self.elevation_m.shape, 3), dtype=np.float32)
        vertices[..., 0] = x_m[None, :]
        vertices[..., 1] = y_m[:, None]
        vertices[..., 2] = self.elevation_m
        return vertices.reshape(-1, 3)

    def triangles(self) -> NDArray[np.int32]:
        """Return (2 * (rows - 1) * (cols - 1), 3) int32 indices, counter-clockwise from above.

        Each cell is cut from its (row, col) corner to its (row + 1, col + 1) corner; the lower
        triangle (towards +x) comes first.
        """
        rows, cols = self.elevation_m.shape
        index = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
        a, b = index[:-1, :-1], index[:-1, 1:]
        c, d = index[1:, 1:], index[1:, :-1]
        corners = np.empty((rows - 1, cols - 1, 6), dtype=np.int32)
        for place, corner in enumerate((a, b, c, a, c, d)):
            corners[..., place] = corner
        return corners.reshape(-1, 3)

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) elevations of the triangulated surface at (N, 2) points; NaN outside it."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        rows, cols = self.elevation_m.shape
        grid = (xy - np.asarray(self.origin_xy_m)) / self.spacing_m
        inside = ((grid >= 0) & (grid <= (cols - 1, rows - 1))).all(axis=1)
        safe = np.where(inside[:, None], grid, 0.0)
        cell = np.minimum(np.floor(safe), (cols - 2, rows - 2)).astype(np.intp)
        s, t = (safe - cell).T
        z = self.elevation_m.astype(np.float64, copy=False)
        z00, z10 = z[cell[:, 1], cell[:, 0]], z[cell[:, 1], cell[:, 0] + 1]
        z01, z11 = z[cell[:, 1] + 1, cell[:, 0]], z[cell[:, 1] + 1, cell[:, 0] + 1]
        lower = z00 + s * (z10 - z00) + t * (z11 - z10)
        upper = z00 + t * (z01 - z00) + s * (z11 - z01)
        return np.where(inside, np.where(s >= t, lower, upper), np.nan)


@dataclass(frozen=True, repr=False)
class WaterSurface(ShortRepr):
    """The optics of a level mesh that is a surface of water.

    Attributes:
        opacity: (V,) uint8, by 255: how much of the bottom is hidden, without reflections.
        waves: Strength of ripples in reflections, 0 to 1.
    """

    opacity: NDArray[np.uint8]
    waves: float


@dataclass(frozen=True, repr=False)
class MeshPrototype(ShortRepr):
    """A mesh of which the world may contain many instances.

    Attributes:
        vertices_m: (V, 3) float32 in the object's frame, with the origin at the centre of its base.
        triangles: (T, 3) int32, counter-clockwise from outside.
        maps: Surface texture, projected from three sides (triplanar).
        color_srgb: Uniform colour, used if there is no other.
        vertex_colors_srgb: (V, 3) uint8, interpolated over the triangles; not used with ``maps``.
        uv: (T, 3, 2) float32 texture coordinates of each triangle's corners in
            ``color_image_srgb``: (0, 0) is its lower left corner, (1, 1) its upper right one. The
            image repeats outside.
        color_image_srgb: (H, W, 3) uint8, first row on top; used instead of vertex colours.
        translucency: (V,) uint8, with ``vertex_colors_srgb``: by 255, the share of scattered light
            that leaves on the other side, as through leaves; None for none.
        water: How it reflects and hides the bottom, if it is water.
        dust_m: Height above the ground up to which the ground's dust lies on it, at a scale of 1.
    """

    name: str
    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]
    maps: PbrMaps | None = None
    color_srgb: tuple[float, float, float] = (0.5, 0.5, 0.5)
    vertex_colors_srgb: NDArray[np.uint8] | None = None
    uv: NDArray[np.float32] | None = None
    color_image_srgb: NDArray[np.uint8] | None = None
    translucency: NDArray[np.uint8] | None = None
    water: WaterSurface | None = None
    dust_m: float = 0.0


@dataclass(frozen=True, repr=False)
class Placement(ShortRepr):
    """The instances of one prototype.

    Attributes:
        prototype: Index into `Scene.prototypes`.
        semantic_ids: From level 0 on.
        T_map_object: (N, 4, 4) float64, rotation times uniform scale, and translation.
        instance_ids: (N,) uint32, unique in the scene, from 1.
        is_moving: Whether its poses change with every sample; those of others rarely change.
    """

    prototype: int
    semantic_ids: tuple[int, ...]
    T_map_object: FloatArray
    instance_ids: NDArray[np.uint32]
    is_moving: bool = False


@dataclass(frozen=True, repr=False)
class Primitive(ShortRepr):
    """An exact sphere or box, for tests and calibration targets.

    Attributes:
        shape: ``sphere`` (with radius size_m[0]) or ``box`` (with edge lengths size_m).
        T_map_object: (4, 4) rigid pose of its centre.
    """

    shape: str
    size_m: tuple[float, float, float]
    T_map_object: FloatArray
    instance_id: int
    semantic_ids: tuple[int, ...]
    color_srgb: tuple[float, float, float]


@dataclass(frozen=True, repr=False)
class WheelTracks(ShortRepr):
    """The tracks that a rover leaves on its way; colour only.

    Attributes:
        way_m: (K, 2) points of its whole way in ``map``.
        wheel_y_m: Distance of its wheels' middle from the way.
        width_m: Width of a wheel.
        driven_share: How much of the way has tracks by now, 0 to 1.
    """

    way_m: FloatArray
    wheel_y_m: float
    width_m: float
    driven_share: float


@dataclass(frozen=True)
class Scene:
    """The world of a batch.

    Attributes:
        stage_hash: Content hash of the ground, by which a backend sees that it did not change.
        semantic_labels: The name of each semantic id in the scene.
        lamps: The lamps that are on, in ``map``.
        tracks: Of rovers that drive on the ground.
        far_ground: The ground beyond the stage, if the sky shows it; it is no part of the ground
            truth mesh.
    """

    ground: Ground
    material: TerrainMaterial
    prototypes: tuple[MeshPrototype, ...]
    placements: tuple[Placement, ...]
    primitives: tuple[Primitive, ...]
    sky: Sky
    semantic_labels: Mapping[int, str]
    stage_hash: str = ""
    custom: Mapping[str, Any] = field(default_factory=dict)
    lamps: tuple[Lamp, ...] = ()
    far_ground: FarGround | None = None
    tracks: tuple[WheelTracks, ...] = ()

    def differs_from(self, other: Scene) -> bool:
        """Return whether a part is a different object, or the light or a label differs."""
        kept = (
            self.ground is other.ground
            and self.far_ground is other.far_ground
            and self.material is other.material
            and self.prototypes is other.prototypes
            and self.placements is other.placements
            and self.primitives is other.primitives
            and self.tracks is other.tracks
        )
        same_light = self.sky == other.sky and self.lamps == other.lamps
        return not (kept and same_light and self.semantic_labels == other.semantic_labels)


@dataclass(frozen=True)
class Lens:
    """A thin lens, for depth of field in colour only.

    Attributes:
        focus_distance_m: Planar distance that is in focus.
        f_number: Focal length divided by the diameter of the aperture.
        blades: Number of aperture blades; below 3 the aperture is round.
        blade_rotation_rad: Rotation of the blades.
        ratio: Width divided by height of the blur; 1 for a spherical lens.
    """

    focus_distance_m: float
    f_number: float
    blades: int = 0
    blade_rotation_rad: float = 0.0
    ratio: float = 1.0


@dataclass(frozen=True, repr=False)
class PlacedCamera(ShortRepr):
    """A camera at the time of a sample.

    Attributes:
        T_map_camera: (4, 4) pose of the optical frame.
        modalities: What to render.
        T_map_previous: (4, 4) pose at this camera's previous sample of the batch, for optical flow
            and motion blur; None at the first.
        lens: Lens for depth of field; None if everything is in focus.
        shutter_share: Share of the motion since the previous pose during which the shutter is
            open; 0 for no motion blur.
        stereo_baseline_m: Distance of the two cameras of a stereo pair, for disparities; 0 for a
            single camera.
        readout_s: Time from the first row's exposure to the last row's; 0 for a global shutter.
        exposure_s: Time for which each row is exposed, which blurs colour.
        pose_at: Poses during readout and exposure, from the middle of the first row's exposure on;
            None: the camera stands still.
    """

    name: str
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray
    modalities: tuple[str, ...]
    T_map_previous: FloatArray | None = None
    lens: Lens | None = None
    shutter_share: float = 0.0
    stereo_baseline_m: float = 0.0
    readout_s: float = 0.0
    exposure_s: float = 0.0
    pose_at: PoseAtTime | None = None

    @property
    def depends_on_past(self) -> bool:
        """Whether the images depend on the camera's pose at the previous sample."""
        is_blurred = (self.shutter_share or self.exposure_s) and RGB in self.modalities
        return FLOW in self.modalities or bool(is_blurred or self.readout_s)

    def row_poses(self) -> FloatArray | None:
        """Return the (H, 4, 4) pose in the middle of each row's exposure; None if all are one."""
        if self.pose_at is None or self.readout_s == 0:
            return None
        return self.pose_at(np.linspace(0.0, self.readout_s, self.intrinsics.height_px))


@dataclass(frozen=True, repr=False)
class ScanPattern(ShortRepr):
    """The rays of a lidar's scan, in the order of their times.

    Attributes:
        directions: (N, 3) unit vectors in the lidar's frame (x forward, y left, z up).
        times_s: (N,) since the beginning of the scan.
        rings: (N,) uint16 channels.
    """

    directions: FloatArray
    times_s: FloatArray
    rings: NDArray[np.uint16]


PoseAtTime = Callable[[FloatArray], FloatArray]
"""Returns the (T, 4, 4) poses ``T_map_sensor`` at (T,) times in seconds since the sample's own."""


@dataclass(frozen=True)
class LidarErrors:
    """Errors of a lidar's measurements; by default none.

    Attributes:
        seed: Root seed of the errors.
        range_sigma_m: Standard deviation of the range.
        drop_from_rad: Angle of incidence from which rays are lost, see `LidarFaultsConfig`.
    """

    seed: int = 0
    range_sigma_m: float = 0.0
    drop_from_rad: float | None = None


@dataclass(frozen=True, repr=False)
class PlacedLidar(ShortRepr):
    """A lidar at the time of a sample; see `LidarConfig` for what it measures.

    Attributes:
        pattern: The rays of this scan.
        T_map_lidar: (4, 4) pose at the beginning of the scan.
        pose_at: Poses during the scan; None: it stands still.
        beam_divergence_rad: Full angle of the beam.
        modalities: `POINTS`, or nothing if it does not scan.
        depends_on_past: Whether the scan depends on the lidar's pose at the previous sample.
    """

    name: str
    pattern: ScanPattern
    T_map_lidar: FloatArray
    min_range_m: float
    max_range_m: float
    reference_range_m: float
    pose_at: PoseAtTime | None = None
    beam_divergence_rad: float = 0.0
    return_separation_m: float = 0.5
    extra_fields: tuple[str, ...] = ()
    errors: LidarErrors = LidarErrors()
    modalities: tuple[str, ...] = (POINTS,)
    depends_on_past: bool = False


def merge_meshes(meshes: list[TriangleMesh]) -> TriangleMesh:
    """Return several meshes as one; either all or none of them have ids."""
    offsets = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    semantic = [m.semantic_ids for m in meshes if m.semantic_ids is not None]
    instance = [m.instance_ids for m in meshes if m.instance_ids is not None]
    return TriangleMesh(
        vertices_m=np.concatenate([m.vertices_m for m in meshes]),
        triangles=np.concatenate(
            [m.triangles + np.int32(o) for m, o in zip(meshes, offsets, strict=True)]
        ),
        semantic_ids=np.concatenate(semantic) if semantic else None,
        instance_ids=np.concatenate(instance) if instance else None,
    )


def stands_on(old: Scene | None, new: Scene) -> bool:
    """Return whether two scenes have the same ground and material."""
    return (
        old is not None
        and bool(new.stage_hash)
        and new.stage_hash == old.stage_hash
        and new.material is old.material
    )
