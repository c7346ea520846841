"""The parameters of the mapper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oaisys_core.files.folders import user_path
from oaisys_mapping.voxels.config import WEIGHTINGS, WHEN_FULL, TsdfConfig
from oaisys_ros_bridge.parameters.ground_maps import ground_map_rows
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow, ParameterTable

_USUAL = TsdfConfig()
_START = Changeable.AT_START
_MEGABYTE = 1_000_000
_FRAME = r"[^\s/][^\s]*"

_VOLUME = (
    ParameterRow(
        "voxel_size",
        _USUAL.voxel_size_m,
        "Edge length of a voxel.",
        unit="m",
        least=1e-3,
        most=100.0,
        changeable=_START,
    ),
    ParameterRow(
        "truncation_voxels",
        _USUAL.truncation_voxels,
        "Truncation distance of the signed distance, in voxels.",
        least=1.0,
        most=100.0,
        changeable=_START,
    ),
    ParameterRow(
        "solid_voxels",
        _USUAL.solid_voxels,
        "Thickness behind a surface, in voxels, that counts as solid until a view shows otherwise; "
        "0: none.",
        least=0.0,
        most=100.0,
        changeable=_START,
    ),
    ParameterRow(
        "max_range",
        _USUAL.max_range_m,
        "Depth beyond which nothing is mapped, and up to which rays that hit nothing clear space; "
        "at most the camera's own range.",
        unit="m",
        least=1e-2,
        most=1e5,
        changeable=_START,
    ),
    ParameterRow(
        "clear_free_space",
        _USUAL.clear_free_space,
        "Whether rays clear the space that they pass through, also those that hit nothing.",
        changeable=_START,
    ),
    ParameterRow(
        "weighting",
        _USUAL.weighting,
        "Weight of a pixel: the same everywhere, or 1 / depth^2.",
        choices=WEIGHTINGS,
        changeable=_START,
    ),
    ParameterRow(
        "weigh_incidence",
        _USUAL.weigh_incidence,
        "Whether a pixel weighs less the more obliquely its ray meets the surface.",
        changeable=_START,
    ),
    ParameterRow(
        "max_weight",
        _USUAL.max_weight,
        "Largest weight of a voxel, so that later views can still change it.",
        least=1e-6,
        most=1e9,
        changeable=_START,
    ),
    ParameterRow(
        "max_memory_mb",
        5000.0,
        "Memory that voxels may use.",
        unit="MB",
        least=1.0,
        most=1e7,
        changeable=_START,
    ),
    ParameterRow(
        "when_full",
        _USUAL.when_full,
        "What happens to a view that needs more memory: it is refused, or the blocks farthest from "
        "the camera are dropped, or they are stored on disk until it comes back.",
        choices=WHEN_FULL,
        changeable=_START,
    ),
    ParameterRow(
        "store_folder",
        "",
        "Folder of stored blocks; empty: that of temporary files.",
        changeable=_START,
    ),
)

_INPUTS = (
    ParameterRow(
        "camera",
        "camera",
        "Prefix of the camera's topics.",
        pattern=r"[^\s]+",
        expects="name without blanks",
        changeable=_START,
    ),
    ParameterRow(
        "map_frame",
        "map",
        "Frame of the volume.",
        pattern=_FRAME,
        expects="name of a frame, without a slash in front",
        changeable=_START,
    ),
    ParameterRow(
        "use_color",
        True,
        "Whether to wait for colour images: for as long as it takes if the bridge announces "
        "complete samples.",
        changeable=_START,
    ),
    ParameterRow(
        "use_semantics",
        False,
        "Whether to wait for label images, too, and to fuse classes.",
        changeable=_START,
    ),
    ParameterRow(
        "semantic_level",
        0,
        "Level of the labels that are fused.",
        least=0,
        most=15,
        changeable=_START,
    ),
    ParameterRow(
        "use_odometry",
        False,
        "Whether poses come from ground_truth/odometry instead of /tf.",
        changeable=_START,
    ),
    ParameterRow(
        "clear_on_batch",
        True,
        "Whether to clear the map when the bridge announces another world.",
        changeable=_START,
    ),
)

_OUTPUTS = (
    ParameterRow(
        "mesh_period",
        5.0,
        "Time between published meshes while frames come; 0: only when one is saved.",
        unit="s",
        least=0.0,
        most=1e6,
        changeable=_START,
    ),
    ParameterRow(
        "mesh_triangles",
        150_000,
        "Most triangles of a published mesh; a saved mesh has all.",
        least=1,
        most=10_000_000,
    ),
    ParameterRow(
        "mesh_colors",
        "image",
        "Colours of published meshes and points: those of the images, or one for each class.",
        choices=("image", "class"),
    ),
    ParameterRow(
        "settle_timeout",
        120.0,
        "Longest time that a service waits for announced samples to be fused.",
        unit="s",
        least=0.0,
        most=1e6,
    ),
)

_DISTANCES = (
    ParameterRow(
        "esdf.length_m",
        0.0,
        "Edge of the slice of the distance field around the newest view, esdf_slice; 0: no slice. "
        "Free space is then recorded, which takes memory.",
        unit="m",
        least=0.0,
        most=1000.0,
        changeable=_START,
    ),
    ParameterRow(
        "esdf.slice_level",
        0.5,
        "Height of the slice, z in the map frame.",
        unit="m",
        least=-1e5,
        most=1e5,
    ),
    ParameterRow(
        "esdf.max_distance_m",
        2.0,
        "Larger distances are told as this one.",
        unit="m",
        least=0.01,
        most=100.0,
    ),
    ParameterRow(
        "esdf.period_s",
        1.0,
        "Least time between two slices; 0: one for each view. Only for subscribers.",
        unit="s",
        least=0.0,
        most=86400.0,
    ),
)

MAPPER = ParameterTable(
    (*_VOLUME, *_INPUTS, *_OUTPUTS, *_DISTANCES, *ground_map_rows(length_m=20.0, period_s=5.0))
)
"""The mapper's parameters."""


def tsdf_config(values: Mapping[str, Any]) -> TsdfConfig:
    """Return the configuration of the volume.

    Raises:
        InvalidInputError: There is no such volume.
    """
    semantic = values["use_semantics"]
    store = values["store_folder"]
    block_bytes = TsdfConfig(semantic=semantic).bytes_per_block
    return TsdfConfig(
        voxel_size_m=values["voxel_size"],
        truncation_voxels=values["truncation_voxels"],
        solid_voxels=values["solid_voxels"],
        max_range_m=values["max_range"],
        max_blocks=max(1, int(values["max_memory_mb"] * _MEGABYTE / block_bytes)),
        when_full=values["when_full"],
        store_folder=user_path(store, "store_folder") if store else None,
        weighting=values["weighting"],
        weigh_incidence=values["weigh_incidence"],
        max_weight=values["max_weight"],
        clear_free_space=values["clear_free_space"],
        record_free_space=values["esdf.length_m"] > 0,
        semantic=semantic,
    )
