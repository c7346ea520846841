"""The parameters of publishing as typed values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from oaisys_core.sensing.faults import DepthFaults
from oaisys_ros_bridge.clouds import CloudOptions
from oaisys_ros_bridge.publishing.compressed import Compression


@dataclass(frozen=True)
class PublishingOptions:
    """How one sample is published.

    Attributes:
        points: Whether clouds are published.
        cloud: Which points clouds have.
        compression: Of compressed images.
        depth_faults: Faults of depth images and of the clouds made of them.
        drift_seed: Seed of the drift of odometry.
        drift_sigmas: Standard deviation of the drift per sample, along (m) and about (rad) an axis.
        tf_drifts: Whether the transform of the rig drifts, too.
        path_length: Most poses of the path.
        viewpoints_count: Most frusta of the viewpoints.
        viewpoints_depth_m: Depth of each frustum.
    """

    points: bool
    cloud: CloudOptions
    compression: Compression
    depth_faults: DepthFaults
    drift_seed: int
    drift_sigmas: tuple[float, float]
    tf_drifts: bool
    path_length: int
    viewpoints_count: int
    viewpoints_depth_m: float

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> PublishingOptions:
        """Return the options from the values of the bridge's parameters."""
        return cls(
            points=values["publish_points"],
            cloud=CloudOptions(
                stride=values["cloud.stride"],
                min_depth_m=values["cloud.min_depth_m"],
                max_depth_m=values["cloud.max_depth_m"],
                drop_sky=values["cloud.drop_sky"],
            ),
            compression=Compression(
                color_format=values["compressed.color_format"],
                jpeg_quality=values["compressed.jpeg_quality"],
                png_level=values["compressed.png_level"],
                depth_encoding=values["compressed.depth_encoding"],
                depth_max_m=values["compressed.depth_max_m"],
                depth_quantization=values["compressed.depth_quantization"],
            ),
            depth_faults=DepthFaults(
                seed=values["faults.seed"],
                noise=values["faults.depth_noise"],
                sigma_m=values["faults.depth_sigma_m"],
                sigma_per_m=values["faults.depth_sigma_per_m"],
                min_depth_m=values["faults.min_depth_m"],
                max_depth_m=values["faults.max_depth_m"],
                missing_ratio=values["faults.missing_ratio"],
            ),
            drift_seed=values["faults.seed"],
            drift_sigmas=(values["faults.drift_m"], values["faults.drift_rad"]),
            tf_drifts=values["faults.tf_drifts"],
            path_length=values["path.length"],
            viewpoints_count=values["viewpoints.count"],
            viewpoints_depth_m=values["viewpoints.depth_m"],
        )
