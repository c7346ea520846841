"""A truncated signed distance field (TSDF) that grows block by block where images show a surface.

Its memory is Open3D's ``VoxelBlockGrid`` on the CPU (Dong et al., "ASH", TPAMI 2022). Views are
integrated by `voxels.integration`; meshes are extracted by `voxels.incremental_mesh`.
"""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.voxels.block_cache import (
    BlockCache,
    ViewBlocks,
    VolumeFullError,
    check_capacity,
)
from oaisys_mapping.voxels.block_layout import (
    CELL_FIELDS,
    NO_BLOCKS,
    SEMANTIC_FIELDS,
    BlockCoordinates,
)
from oaisys_mapping.voxels.config import TsdfConfig
from oaisys_mapping.voxels.free_space import DepthPyramid, FreeBlocks
from oaisys_mapping.voxels.incremental_mesh import IncrementalMesh
from oaisys_mapping.voxels.integration import POOL, integrate_view
from oaisys_mapping.voxels.label_cells import LabelCells
from oaisys_mapping.voxels.padded_images import PaddedImages, check_view, pad_images
from oaisys_mapping.voxels.volume_file import (
    CELL_BLOCKS,
    VOXEL_BLOCKS,
    VolumeHeader,
    read_volume,
    write_volume,
)
from oaisys_mapping.voxels.voxel_queries import (
    ClassGrid,
    ObservedVoxels,
    classes_at,
    distances_at,
    volume_observed_m3,
    voxel_observations,
)

__all__ = ["TsdfConfig", "TsdfVolume", "VolumeFullError"]

VOXEL_VOTE_WEIGHT = 0.25
"""Weight of the class votes of voxels relative to those of label cells."""


class TsdfVolume:
    """Integrates depth, colour and label images of known pose into one surface."""

    def __init__(self, config: TsdfConfig | None = None) -> None:
        self.config = config or TsdfConfig()
        self.reset()

    def reset(self) -> None:
        """Forget all views."""
        config = self.config
        self.frames = 0
        self._voxels = BlockCache(
            config.voxel_size_m,
            config.fields,
            max_blocks=config.max_blocks,
            when_full=config.when_full,
            store_folder=config.store_folder,
        )
        self._cells: LabelCells | None = None
        if config.semantic:
            self._cells = LabelCells(config.voxel_size_m, config.max_blocks, config.store_folder)
        self._mesh = self._new_mesh()
        self._free = FreeBlocks()

    def integrate(
        self,
        depth_m: NDArray[np.float32],
        rgb: NDArray[np.uint8] | None,
        intrinsics: PinholeIntrinsics,
        T_map_camera: FloatArray,
        labels: NDArray[np.uint16] | None = None,
    ) -> None:
        """Integrate one view.

        Args:
            depth_m: (H, W) float32 planar depth; ``+inf`` where the ray hit nothing. NaN and
                values not above 0 are ignored.
            rgb: (H, W, 3) uint8 of the same camera, or None.
            intrinsics: The camera, without distortion; see `rectification`.
            T_map_camera: (4, 4) pose of its optical frame.
            labels: (H, W) uint16 classes of the same camera, 0 where unlabelled, or None. Only a
                ``semantic`` volume keeps them.

        Raises:
            InvalidInputError: The images' sizes do not fit the camera, the camera has distortion,
                or the pose is not finite.
            VolumeFullError: The view would need more than ``max_blocks``; the volume is unchanged.
        """
        check_view(depth_m, rgb, labels, intrinsics, T_map_camera)
        config, camera_m = self.config, T_map_camera[:3, 3]
        images = pad_images(depth_m, rgb, labels, intrinsics, T_map_camera, config)
        rays = DepthPyramid(images, config.voxel_size_m)
        near = self._voxels.near_surface(
            depth_m, intrinsics, T_map_camera, config.max_range_m, config.truncation_voxels
        )
        loaded = self._voxels.load_view(near, rays if config.clear_free_space else None, camera_m)
        self._follow(loaded)
        votes = self._start_voting(images, near)
        updated = integrate_view(self._voxels.arrays, loaded.blocks, loaded.slots, images, config)
        self._mesh.mark_changed(loaded.blocks[updated])
        if votes is not None:
            self._mesh.mark_changed(votes.result())
        if config.record_free_space:
            self._free.add(rays.free_blocks(), camera_m / config.block_size_m)
        self.frames += 1

    def extract_mesh(self, *, with_stored: bool = True) -> ColoredMesh:
        """Return the zero level set as a mesh whose order depends on the map's content alone.

        Only regions that changed since the last call are meshed again, and, unless excluded,
        regions on disk.
        """
        self._mesh.update(self._voxels.read)
        stored = self._voxels.blocks_on_disk if with_stored else NO_BLOCKS
        return self._mesh.mesh(stored, self._voxels.read)

    def forget_mesh(self) -> None:
        """Free the memory of the last mesh; the next one is made from scratch."""
        self._mesh = self._new_mesh()
        self._mesh.mark_changed(self._voxels.blocks_in_memory)

    @property
    def is_empty(self) -> bool:
        """Whether no integrated view showed a surface."""
        return self.blocks_in_memory + self.blocks_stored == 0

    @property
    def blocks_in_memory(self) -> int:
        """How many blocks are in memory."""
        return self._voxels.count_in_memory

    @property
    def cell_blocks_in_memory(self) -> int:
        """How many blocks of label cells are in memory."""
        return self._cells.cache.count_in_memory if self._cells is not None else 0

    @property
    def blocks_stored(self) -> int:
        """How many blocks are on disk."""
        return self._voxels.count_stored

    @property
    def volume_observed_m3(self) -> float:
        """Volume of all observed voxels and of recorded free blocks."""
        return volume_observed_m3(self._voxels, self._free.keys)

    def classes_at(self, points_m: FloatArray) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Return the (N,) classes at (N, 3) points, and their shares of the votes there.

        The eight label cells around a point vote with trilinear weights, as do, with less weight,
        the eight voxels. Where there are no votes, class and share are 0.
        """
        if self._cells is None:
            raise InvalidInputError("semantic", False, "a volume that keeps classes")
        cells = ClassGrid(self._cells.cache, CELL_FIELDS, 1.0)
        voxels = ClassGrid(self._voxels, SEMANTIC_FIELDS, VOXEL_VOTE_WEIGHT)
        return classes_at(points_m, (cells, voxels))

    def distance_at(self, points_m: FloatArray) -> FloatArray:
        """Return the (N,) signed projective distances in metres at (N, 3) points.

        They are negative behind the surface and clipped to the truncation; NaN where a voxel around
        the point was neither observed nor counts as solid close behind a surface. For distances
        beyond the truncation see `oaisys_mapping.distance_field`.
        """
        config = self.config
        return distances_at(points_m, config.voxel_size_m, config.truncation_m, self._voxels.read)

    def observations(self, low: BlockCoordinates, high: BlockCoordinates) -> ObservedVoxels:
        """Return the observations of voxels from (3,) ``low`` up to, not including, ``high``."""
        return voxel_observations(
            low, high, self.config.truncation_m, self._free.keys, self._voxels.read
        )

    def save(self, path: Path) -> None:
        """Write the volume to an ``.npz`` file; inverse: `load`.

        See `oaisys_mapping.voxels.volume_file`: equal views in equal order give equal bytes.
        """
        config = self.config
        header = VolumeHeader(
            config.voxel_size_m, config.truncation_m, self.frames, self._free.blocks
        )
        write_volume(path, header, self._grids)

    def load(self, path: Path) -> None:
        """Replace the volume's content by that of a file.

        Raises:
            InvalidInputError: The file is not a volume, or has another voxel size or truncation.
            VolumeFullError: It holds more than ``max_blocks``; the volume is unchanged.
        """
        fields = {name: grid.fields for name, grid in self._grids.items()}
        header, contents = read_volume(path, fields)
        header.check_matches(self.config, path)
        check_capacity(len(contents[VOXEL_BLOCKS][0]), self.config.max_blocks)
        self.reset()
        for name, (blocks, values) in contents.items():
            self._grids[name].insert(blocks, values)
        self._mesh.mark_changed(self._voxels.blocks_in_memory)
        self._free = FreeBlocks(header.free)
        self.frames = header.frames

    @property
    def _grids(self) -> dict[str, BlockCache]:
        """The grids of blocks, by their names in files."""
        cells = {} if self._cells is None else {CELL_BLOCKS: self._cells.cache}
        return {VOXEL_BLOCKS: self._voxels, **cells}

    def _new_mesh(self) -> IncrementalMesh:
        classes_at = self.classes_at if self.config.semantic else None
        return IncrementalMesh(self.config.voxel_size_m, classes_at)

    def _follow(self, loaded: ViewBlocks) -> None:
        """Let mesh and label cells follow the blocks that were evicted or restored."""
        if len(loaded.evicted):
            if self.config.when_full == "drop":
                self._mesh.mark_changed(loaded.evicted)
            else:  # The mesh of stored blocks is made from disk when it is needed.
                self._mesh.keep_only(self._voxels.blocks_in_memory)
        self._mesh.mark_changed(loaded.restored)
        if self._cells is not None:
            stores = self.config.when_full == "store"
            self._cells.follow(loaded.evicted, loaded.restored, store=stores)

    def _start_voting(
        self, images: PaddedImages, near: BlockCoordinates
    ) -> Future[BlockCoordinates] | None:
        """Start to count the label cells' votes; the result is the blocks whose votes changed."""
        if self._cells is None or images.labels is None:
            return None
        return POOL.submit(self._cells.vote, images, near)
