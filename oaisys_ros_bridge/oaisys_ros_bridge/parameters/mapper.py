"""The parameters of the mapper; those of the other nodes are in `parameters`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from oaisys_mapping.voxels.config import WEIGHTINGS, WHEN_FULL, TsdfConfig
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
        "Distance from the surface, in voxels, up to which distances are kept.",
        least=1.0,
        most=100.0,
        changeable=_START,
    ),
    ParameterRow(
        "solid_voxels",
        _USUAL.solid_voxels,
        "How much further behind a surface, in voxels, is taken for solid until a view tells "
        "otherwise; 0: nothing is.",
        least=0.0,
        most=100.0,
        changeable=_START,
    ),
    ParameterRow(
        "max_range",
        _USUAL.max_range_m,
        "Depth beyond which nothing is mapped, and up to which rays that hit nothing clear; no "
        "more than the camera's own range.",
        unit="m",
        least=1e-2,
        most=1e5,
        changeable=_START,
    ),
    ParameterRow(
        "clear_free_space",
        _USUAL.clear_free_space,
        "Whether rays clear what they pass through, also those that hit nothing.",
        changeable=_START,
    ),
    ParameterRow(
        "weighting",
        _USUAL.weighting,
        "What a pixel counts: the same everywhere, or 1 / depth^2.",
        choices=WEIGHTINGS,
        changeable=_START,
    ),
    ParameterRow(
        "weigh_incidence",
        _USUAL.weigh_incidence,
        "Whether a pixel counts less the flatter its ray meets the surface.",
        changeable=_START,
    ),
    ParameterRow(
        "max_weight",
        _USUAL.max_weight,
        "Weight beyond which a voxel's does not grow, so that it can change its mind.",
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
        "What becomes of a view that needs more memory: it is refused, or those blocks that are "
        "farthest from the camera are dropped, or stored on disk until it comes back.",
        choices=WHEN_FULL,
        changeable=_START,
    ),
    ParameterRow(
        "store_folder",
        "",
        "Where stored blocks go; empty: where temporary files do.",
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
        "Whether to wait for colour images: as long as it takes where the bridge tells which "
        "samples are complete.",
        changeable=_START,
    ),
    ParameterRow(
        "use_semantics",
        False,
        "Whether to wait for label images likewise, and to fuse classes.",
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
        "Whether to begin anew when the bridge says that another world stands.",
        changeable=_START,
    ),
)

_OUTPUTS = (
    ParameterRow(
        "mesh_period",
        5.0,
        "Time between meshes published while frames come; 0: only when one is saved.",
        unit="s",
        least=0.0,
        most=1e6,
        changeable=_START,
    ),
    ParameterRow(
        "mesh_triangles",
        150_000,
        "Most triangles of a published mesh; a saved one has them all.",
        least=1,
        most=10_000_000,
    ),
    ParameterRow(
        "mesh_colors",
        "image",
        "What colours of published meshes and points mean: as seen, or a colour for each class.",
        choices=("image", "class"),
    ),
    ParameterRow(
        "settle_timeout",
        120.0,
        "Longest time that a service waits for frames that are being fused.",
        unit="s",
        least=0.0,
        most=1e6,
    ),
)

MAPPER = ParameterTable((*_VOLUME, *_INPUTS, *_OUTPUTS))
"""The mapper's parameters."""


def tsdf_config(values: Mapping[str, Any]) -> TsdfConfig:
    """Return the volume that parameters ask for.

    Raises:
        InvalidInputError: There is none of that kind.
    """
    semantic = values["use_semantics"]
    block_bytes = TsdfConfig(semantic=semantic).bytes_per_block
    return TsdfConfig(
        voxel_size_m=values["voxel_size"],
        truncation_voxels=values["truncation_voxels"],
        solid_voxels=values["solid_voxels"],
        max_range_m=values["max_range"],
        max_blocks=max(1, int(values["max_memory_mb"] * _MEGABYTE / block_bytes)),
        when_full=values["when_full"],
        store_folder=Path(values["store_folder"]) if values["store_folder"] else None,
        weighting=values["weighting"],
        weigh_incidence=values["weigh_incidence"],
        max_weight=values["max_weight"],
        clear_free_space=values["clear_free_space"],
        semantic=semantic,
    )
