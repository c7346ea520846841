"""A truncated signed distance field that grows block by block where depth images show a surface.

Its memory is Open3D's ``VoxelBlockGrid`` on the CPU (Dong et al., "ASH", TPAMI 2022); views are
fused by `voxels.integration` and meshed by `voxels.incremental_mesh`.
"""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.voxels.block_cache import BlockCache, ViewBlocks, VolumeFullError, check_room
from oaisys_mapping.voxels.blocks import Coordinates, packed, unpacked
from oaisys_mapping.voxels.config import TsdfConfig
from oaisys_mapping.voxels.incremental_mesh import IncrementalMesh
from oaisys_mapping.voxels.integration import POOL, IntegrationRules, integrate_view
from oaisys_mapping.voxels.label_cells import CELL_FIELDS, LabelCells
from oaisys_mapping.voxels.padded_images import FreeSpace, PaddedImages, padded_images
from oaisys_mapping.voxels.semantic_fusion import SEMANTIC_FIELDS
from oaisys_mapping.voxels.volume_file import (
    CELL_BLOCKS,
    VOXEL_BLOCKS,
    StoredGrid,
    VolumeHeader,
    read_volume,
    write_volume,
)
from oaisys_mapping.voxels.voxel_queries import (
    ClassVotes,
    ObservedVoxels,
    classes_at,
    distances_at,
    is_seen,
    observed_voxels,
)

__all__ = ["TsdfConfig", "TsdfVolume", "VolumeFullError"]

SEARCH_STRIDE_PX = 4
"""Open3D looks at every fourth pixel for blocks to map, and raises where all of these are empty."""

VOXEL_VOTES = 0.25
"""What a vote of a voxel's classes counts beside one of a cell's. Of 0 to 1 the best on the demo's
worlds, by little."""

DESCRIBED_VOXELS = 2.0
"""How far in front of the surface voxels keep colours and classes."""

MOST_FREE_BLOCKS = 2_000_000
"""Blocks known to be free that are remembered, 8 bytes each; those far from the camera go first."""


class TsdfVolume:
    """Fuses depth, colour and label images of known pose into one surface."""

    def __init__(self, config: TsdfConfig | None = None) -> None:
        self.config = config or TsdfConfig()
        described_m = min(DESCRIBED_VOXELS * self.config.voxel_size_m, self.config.truncation_m)
        self._rules = IntegrationRules(
            self.config.voxel_size_m,
            self.config.truncation_m,
            described_m,
            self.config.max_weight,
            self.config.truncation_m + self.config.solid_voxels * self.config.voxel_size_m,
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.frames = 0
        self._working = BlockCache(
            self.config.voxel_size_m,
            self.config.fields,
            most_blocks=self.config.max_blocks,
            when_full=self.config.when_full,
            store_folder=self.config.store_folder,
        )
        self._cells: LabelCells | None = None
        if self.config.semantic:
            size_m, most, folder = (
                self.config.voxel_size_m,
                self.config.max_blocks,
                self.config.store_folder,
            )
            self._cells = LabelCells(size_m, most, folder)
        self._mesh = self._new_mesh()
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
    def cell_blocks_in_memory(self) -> int:
        """How many blocks of `LabelCells` are in memory."""
        return self._cells.blocks_in_memory if self._cells is not None else 0

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
        seen = padded_images(
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
        voting = self._voting(seen, near, changes)
        changed = integrate_view(
            self._working.arrays, changes.blocks, changes.slots, seen, self._rules
        )
        self._mesh.change(changes.blocks[changed])
        if voting is not None:
            self._mesh.change(voting.result())
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
        self._mesh = self._new_mesh()
        self._mesh.change(self._working.blocks_in_memory)

    def classes_at(self, points_m: FloatArray) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Return the (N,) classes of (N, 3) points, and their shares of what was told there.

        Asked are the eight cells around a point, by trilinear weight, and, for less, the eight
        voxels; 0 where none was told.
        """
        if self._cells is None:
            raise InvalidInputError("semantic", False, "a volume that keeps classes")
        ids, weights = (field.name for field in SEMANTIC_FIELDS)
        cell_ids, cell_weights = (field.name for field in CELL_FIELDS)
        votes = (
            ClassVotes(self._cells.cell_m, self._cells.values, cell_ids, cell_weights, 1.0),
            ClassVotes(self.config.voxel_size_m, self._working.values, ids, weights, VOXEL_VOTES),
        )
        return classes_at(points_m, votes)

    def distance_at(self, points_m: FloatArray) -> FloatArray:
        """Return the (N,) signed projective distances in metres at (N, 3) points.

        Below 0 behind the surface, clipped to the truncation, NaN where a voxel around the point
        was neither seen nor lies so close behind a surface that it is taken for solid. For
        distances beyond the truncation see `oaisys_mapping.distance_field`.
        """
        size_m, truncation_m = self.config.voxel_size_m, self.config.truncation_m
        return distances_at(points_m, size_m, truncation_m, self._working.values)

    @property
    def observed_volume_m3(self) -> float:
        """Volume of the voxels that some view told something about, and of recorded free blocks."""
        voxels, blocks = 0, self._working.all_blocks
        for first in range(0, len(blocks), 4096):
            rows = self._working.rows(blocks[first : first + 4096])
            voxels += int(is_seen(rows["tsdf"], rows["weight"]).sum())
        only_free = np.setdiff1d(self._free, packed(blocks))
        return voxels * self.config.voxel_size_m**3 + len(only_free) * self.config.block_size_m**3

    def observed(self, low: Coordinates, high: Coordinates) -> ObservedVoxels:
        """Return what is known of the voxels from (3,) ``low`` up to, not including, ``high``."""
        return observed_voxels(
            low, high, self.config.truncation_m, self._free, self._working.values
        )

    def save(self, path: Path) -> None:
        """Write the volume's content to an ``.npz`` file; inverse: `load`.

        See `oaisys_mapping.voxels.volume_file`: equal views in equal order give equal bytes.
        """
        header = VolumeHeader(
            self.config.voxel_size_m, self.config.truncation_m, self.frames, unpacked(self._free)
        )
        working = self._working
        grids = [StoredGrid(VOXEL_BLOCKS, self.config.fields, working.all_blocks, working.rows)]
        if self._cells is not None:
            cells = self._cells
            grids.append(StoredGrid(CELL_BLOCKS, CELL_FIELDS, cells.all_blocks, cells.rows))
        write_volume(path, header, grids)

    def load(self, path: Path) -> None:
        """Replace the volume's content by a file's.

        Raises:
            InvalidInputError: The file is no volume, or one of another voxel size or truncation.
            VolumeFullError: It holds more than ``max_blocks``; the volume is unchanged.
        """
        kept = {VOXEL_BLOCKS: self.config.fields}
        if self.config.semantic:
            kept[CELL_BLOCKS] = CELL_FIELDS
        header, grids = read_volume(path, kept)
        blocks, rows = grids[VOXEL_BLOCKS]
        for name in ("voxel_size_m", "truncation_m"):
            found, own = getattr(header, name), getattr(self.config, name)
            if not np.isclose(found, own):
                raise InvalidInputError("path", f"{path}: {name} {found:g}", f"{own:g} m")
        check_room(len(blocks), self.config.max_blocks)
        self.reset()
        self._working.fill(blocks, rows)
        self._mesh.change(blocks)
        if self._cells is not None and CELL_BLOCKS in grids:
            self._cells.fill(*grids[CELL_BLOCKS])
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

    def _new_mesh(self) -> IncrementalMesh:
        classes_at = self.classes_at if self.config.semantic else None
        return IncrementalMesh(self.config.voxel_size_m, classes_at)

    def _voting(
        self, seen: PaddedImages, near: Coordinates, changes: ViewBlocks
    ) -> Future[Coordinates] | None:
        """Let cells go and come with their voxels, and begin to count what a view tells them."""
        if self._cells is None:
            return None
        stores = self.config.when_full == "store"
        self._cells.follow(changes.gone, changes.restored, stores=stores)
        if seen.labels is None:
            return None
        return POOL.submit(self._cells.vote, seen, near)

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
