"""A truncated signed distance field that grows block by block where depth images show a surface.

Its memory is Open3D's ``VoxelBlockGrid`` on the CPU (Dong et al., "ASH", TPAMI 2022); views are
fused by `oaisys_mapping.fusing`, meshes made by `oaisys_mapping.block_mesh`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.block_mesh import BlockMesh
from oaisys_mapping.blocks import (
    BLOCK_VOXELS,
    GEOMETRY_FIELDS,
    Coordinates,
    VoxelField,
    block_bytes,
    packed,
    unpacked,
)
from oaisys_mapping.fusing import FusionRules, fuse
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.observation import FreeSpace, observation
from oaisys_mapping.semantic_fusion import SEMANTIC_FIELDS
from oaisys_mapping.volume_file import VolumeHeader, read_volume, write_volume
from oaisys_mapping.voxel_queries import ObservedVoxels, classes_at, distances_at, observed_voxels
from oaisys_mapping.working_set import WHEN_FULL, VolumeFullError, WorkingSet, check_room

__all__ = ["TsdfConfig", "TsdfVolume", "VolumeFullError"]

SEARCH_STRIDE_PX = 4
"""Open3D looks at every fourth pixel for blocks to map, and raises where all of these are empty."""

DESCRIBED_VOXELS = 2.0
"""How far in front of the surface voxels keep colours and classes."""

MOST_FREE_BLOCKS = 2_000_000
"""Blocks known to be free that are remembered, 8 bytes each; those far from the camera go first."""

WEIGHTINGS = ("constant", "inverse_square")


@dataclass(frozen=True)
class TsdfConfig:
    """How a volume is made.

    Attributes:
        voxel_size_m: Edge length of a voxel.
        truncation_voxels: Distance from the surface, in voxels, up to which distances are kept. On
            rocky ground seen from 10 m at 0.1 m, 2 / 3 / 4 / 6 gave an RMSE of 4.5 / 5.6 / 7.2 /
            10.3 mm and holes of 1.0 / 0.5 / 0.4 / 0.3 %.
        max_range_m: Depth beyond which nothing is integrated, and up to which a ray that hit
            nothing, or something further away, clears. No more than the camera's own range.
        max_blocks: Blocks of 8 x 8 x 8 voxels that may be in memory: 400,000 take 4.9 GB; see
            `bytes_per_block`.
        when_full: What becomes of a view that needs more: ``refuse`` it, or make room for it with
            the blocks that are farthest from the camera: ``drop`` them, or ``store`` them on disk
            until the camera comes back.
        store_folder: Where stored blocks go; None: where temporary files do.
        weighting: What a pixel counts: ``constant``: 1, or ``inverse_square``: 1 / depth^2, as the
            noise of depth cameras asks for.
        weigh_incidence: Whether it counts less the flatter the ray meets the surface (cosine).
        max_weight: Weight beyond which a voxel's does not grow, so that it can change its mind.
        clear_free_space: Whether rays clear blocks that they pass through, also those that hit
            nothing; without it, a thing that moved away stays.
        record_free_space: Whether to remember which blocks without voxels are free; for distance
            queries in the open.
        semantic: Whether voxels keep classes.
    """

    voxel_size_m: float = 0.10
    truncation_voxels: float = 3.0
    max_range_m: float = 60.0
    max_blocks: int = 400_000
    when_full: str = "refuse"
    store_folder: Path | None = None
    weighting: str = "constant"
    weigh_incidence: bool = False
    max_weight: float = 100.0
    clear_free_space: bool = True
    record_free_space: bool = False
    semantic: bool = False

    def __post_init__(self) -> None:
        """Refuse sizes that are not above 0, and choices that there are not."""
        for name in ("voxel_size_m", "truncation_voxels", "max_range_m", "max_blocks"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InvalidInputError(name, value, "a finite number above 0")
        if not self.max_weight > 0:
            raise InvalidInputError("max_weight", self.max_weight, "a number above 0")
        for name, choices in (("weighting", WEIGHTINGS), ("when_full", WHEN_FULL)):
            if getattr(self, name) not in choices:
                raise InvalidInputError(name, getattr(self, name), f"one of {', '.join(choices)}")

    @property
    def truncation_m(self) -> float:
        """Distance up to which distances are kept."""
        return self.truncation_voxels * self.voxel_size_m

    @property
    def fields(self) -> tuple[VoxelField, ...]:
        """What is kept of a voxel."""
        return (*GEOMETRY_FIELDS, *SEMANTIC_FIELDS) if self.semantic else GEOMETRY_FIELDS

    @property
    def block_size_m(self) -> float:
        """Edge length of a block."""
        return BLOCK_VOXELS * self.voxel_size_m

    @property
    def bytes_per_block(self) -> int:
        """Memory that a block takes: 12 kB, 24 kB with classes."""
        return block_bytes(self.fields)


class TsdfVolume:
    """Fuses depth, colour and label images of known pose into one surface."""

    def __init__(self, config: TsdfConfig | None = None) -> None:
        self.config = config or TsdfConfig()
        described_m = min(DESCRIBED_VOXELS * self.config.voxel_size_m, self.config.truncation_m)
        self._rules = FusionRules(
            self.config.voxel_size_m,
            self.config.truncation_m,
            described_m,
            self.config.max_weight,
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.frames = 0
        self._working = WorkingSet(
            self.config.voxel_size_m,
            self.config.fields,
            most_blocks=self.config.max_blocks,
            when_full=self.config.when_full,
            store_folder=self.config.store_folder,
        )
        self._mesh = BlockMesh(self.config.voxel_size_m, has_classes=self.config.semantic)
        self._free = np.zeros(0, np.int64)

    @property
    def is_empty(self) -> bool:
        """Whether nothing was integrated that showed a surface."""
        return self.blocks_in_memory + self.blocks_stored == 0

    @property
    def blocks_in_memory(self) -> int:
        """How many blocks are in memory."""
        return self._working.in_memory

    @property
    def blocks_stored(self) -> int:
        """How many blocks are on disk."""
        return self._working.stored

    def integrate(
        self,
        depth_m: NDArray[np.float32],
        rgb: NDArray[np.uint8] | None,
        intrinsics: PinholeIntrinsics,
        T_map_camera: FloatArray,
        labels: NDArray[np.uint16] | None = None,
    ) -> None:
        """Fuse one view.

        Args:
            depth_m: (H, W) float32 planar depth; ``+inf`` where the ray hit nothing. What is NaN,
                or not above 0, is skipped.
            rgb: (H, W, 3) uint8 of the same camera, or None: no colour is told.
            intrinsics: The camera, without distortion; see `rectified`.
            T_map_camera: (4, 4) pose of its optical frame.
            labels: (H, W) uint16 classes of the same camera, 0 where unlabelled, or None; kept
                only by a ``semantic`` volume.

        Raises:
            InvalidInputError: The images' sizes do not fit the camera, it distorts, or the pose is
                not finite.
            VolumeFullError: The view would need more than ``max_blocks``; the volume is unchanged.
        """
        self._check(depth_m, rgb, labels, intrinsics, T_map_camera)
        config = self.config
        seen = observation(
            depth_m,
            rgb,
            labels,
            intrinsics,
            T_map_camera,
            max_range_m=config.max_range_m,
            weighting=config.weighting,
            by_incidence=config.weigh_incidence,
            clears=config.clear_free_space,
        )
        near = self._near_surface(depth_m, intrinsics, T_map_camera)
        space = None
        if config.clear_free_space or config.record_free_space:
            space = FreeSpace(seen, config.voxel_size_m)
        clears = space if config.clear_free_space else None
        changes = self._working.make_ready(near, clears, T_map_camera[:3, 3])
        if len(changes.gone):
            self._let_go(changes.gone)
        self._mesh.change(changes.restored)
        changed = fuse(self._working.arrays, changes.blocks, changes.slots, seen, self._rules)
        self._mesh.change(changes.blocks[changed])
        if space is not None and config.record_free_space:
            self._remember_free(space, T_map_camera[:3, 3])
        self.frames += 1

    def extract_mesh(self, *, with_stored: bool = True) -> ColoredMesh:
        """Return the zero level as a mesh, in an order that depends on its content alone.

        Only what changed since the last call is worked on; and what is on disk, if asked for.
        """
        self._mesh.update(self._working.values)
        stored = self._working.stored_blocks if with_stored else np.zeros((0, 3), np.int32)
        return self._mesh.mesh(stored, self._working.values)

    def forget_mesh(self) -> None:
        """Let the next mesh be made anew, and give the memory of the last one back."""
        self._mesh = BlockMesh(self.config.voxel_size_m, has_classes=self.config.semantic)
        self._mesh.change(self._working.blocks_in_memory)

    def classes_at(self, points_m: FloatArray) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Return the (N,) classes of (N, 3) points, and their shares of what was told there.

        Asked are the eight voxels around a point, by trilinear weight; 0 where none was told.
        """
        if not self.config.semantic:
            raise InvalidInputError("semantic", False, "a volume that keeps classes")
        return classes_at(points_m, self.config.voxel_size_m, self._working.values)

    def distance_at(self, points_m: FloatArray) -> FloatArray:
        """Return the (N,) signed projective distances in metres at (N, 3) points.

        Below 0 behind the surface, clipped to the truncation, NaN where a voxel around the point
        was not seen. For distances beyond the truncation see `oaisys_mapping.distance_field`.
        """
        size_m, truncation_m = self.config.voxel_size_m, self.config.truncation_m
        return distances_at(points_m, size_m, truncation_m, self._working.values)

    @property
    def observed_volume_m3(self) -> float:
        """Volume of the voxels that some view told something about, and of recorded free blocks."""
        voxels, blocks = 0, self._working.all_blocks
        for first in range(0, len(blocks), 4096):
            voxels += int((self._working.rows(blocks[first : first + 4096])["weight"] > 0).sum())
        only_free = np.setdiff1d(self._free, packed(blocks))
        return voxels * self.config.voxel_size_m**3 + len(only_free) * self.config.block_size_m**3

    def observed(self, low: Coordinates, high: Coordinates) -> ObservedVoxels:
        """Return what is known of the voxels from (3,) ``low`` up to, not including, ``high``."""
        return observed_voxels(
            low, high, self.config.truncation_m, self._free, self._working.values
        )

    def save(self, path: Path) -> None:
        """Write the volume's content to an ``.npz`` file; inverse: `load`.

        See `oaisys_mapping.volume_file`: equal views in equal order give equal bytes.
        """
        header = VolumeHeader(
            self.config.voxel_size_m,
            self.config.truncation_m,
            self.frames,
            self._working.all_blocks,
            unpacked(self._free),
        )
        write_volume(path, header, self.config.fields, self._working.rows)

    def load(self, path: Path) -> None:
        """Replace the volume's content by a file's.

        Raises:
            InvalidInputError: The file is no volume, or one of another voxel size or truncation.
            VolumeFullError: It holds more than ``max_blocks``; the volume is unchanged.
        """
        header, rows = read_volume(path, self.config.fields)
        for name in ("voxel_size_m", "truncation_m"):
            found, own = getattr(header, name), getattr(self.config, name)
            if not np.isclose(found, own):
                raise InvalidInputError("path", f"{path}: {name} {found:g}", f"{own:g} m")
        check_room(len(header.blocks), self.config.max_blocks)
        self.reset()
        self._working.fill(header.blocks, rows)
        self._mesh.change(header.blocks)
        self._free = packed(header.free)
        self.frames = header.frames

    def _near_surface(
        self, depth_m: NDArray[np.float32], camera: PinholeIntrinsics, T_map_camera: FloatArray
    ) -> Coordinates:
        """Return the (N, 3) blocks that the view shows a surface in."""
        with np.errstate(invalid="ignore"):
            is_near = (depth_m > 0) & (depth_m < self.config.max_range_m)
        if not _shows_a_surface(is_near):
            return np.zeros((0, 3), np.int32)
        shown = np.where(is_near, depth_m, np.float32(0))
        depth = o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(shown, np.float32)))
        far = (self.config.max_range_m, self.config.truncation_voxels)
        return self._working.near_surface(depth, camera.K, invert(T_map_camera), far)

    def _let_go(self, blocks: Coordinates) -> None:
        """Forget the surface of dropped blocks; that of stored ones can be made from disk."""
        if self.config.when_full == "drop":
            self._mesh.change(blocks)
        else:
            self._mesh.keep_only(self._working.blocks_in_memory)

    def _remember_free(self, space: FreeSpace, camera_m: FloatArray) -> None:
        free = np.union1d(self._free, packed(space.free_blocks()))
        if len(free) > MOST_FREE_BLOCKS:
            away = np.abs(unpacked(free) - camera_m / self.config.block_size_m).max(axis=1)
            free = free[np.sort(np.argsort(away, kind="stable")[:MOST_FREE_BLOCKS])]
        self._free = free

    def _check(
        self,
        depth_m: NDArray[np.float32],
        rgb: NDArray[np.uint8] | None,
        labels: NDArray[np.uint16] | None,
        intrinsics: PinholeIntrinsics,
        T_map_camera: FloatArray,
    ) -> None:
        size = (intrinsics.height_px, intrinsics.width_px)
        if depth_m.shape != size:
            raise InvalidInputError("depth_m", depth_m.shape, f"an image of shape {size}")
        if rgb is not None and rgb.shape != (*size, 3):
            raise InvalidInputError("rgb", rgb.shape, f"an image of shape {(*size, 3)}")
        if labels is not None and labels.shape != size:
            raise InvalidInputError("labels", labels.shape, f"an image of shape {size}")
        if any(intrinsics.distortion):
            raise InvalidInputError("intrinsics.distortion", intrinsics.distortion, "none")
        if np.shape(T_map_camera) != (4, 4) or not np.isfinite(T_map_camera).all():
            raise InvalidInputError("T_map_camera", T_map_camera, "a finite (4, 4) transform")


def _shows_a_surface(seen: NDArray[np.bool_]) -> bool:
    height, width = (size // SEARCH_STRIDE_PX * SEARCH_STRIDE_PX for size in seen.shape)
    return bool(seen[:height:SEARCH_STRIDE_PX, :width:SEARCH_STRIDE_PX].any())
