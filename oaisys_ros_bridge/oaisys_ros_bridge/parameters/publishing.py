"""The parameters of the bridge that say how samples are published."""

from __future__ import annotations

from oaisys_ros_bridge.parameters.table import ParameterRow

FARTHEST_M = 1e6

CLOUDS = (
    ParameterRow(
        "publish_points",
        True,
        "Whether to publish clouds.",
    ),
    ParameterRow(
        "cloud.stride",
        1,
        "Only every so many columns and rows of the depth image become points.",
        unit="px",
        least=1,
        most=64,
    ),
    ParameterRow(
        "cloud.min_depth_m",
        0.0,
        "What is nearer, along the optical axis, becomes no point.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "cloud.max_depth_m",
        0.0,
        "What is farther, along the optical axis, becomes no point; 0: no limit.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "cloud.drop_sky",
        False,
        "Whether a cloud is one row of the points that there are; false: organised as the image, "
        "NaN where there is none.",
    ),
)

COMPRESSED = (
    ParameterRow(
        "compressed.color_format",
        "jpeg",
        "Of colour on .../compressed; labels and ids are always PNG, which loses nothing.",
        choices=("jpeg", "png"),
    ),
    ParameterRow(
        "compressed.jpeg_quality",
        95,
        "Of JPEG.",
        least=1,
        most=100,
    ),
    ParameterRow(
        "compressed.png_level",
        1,
        "Of PNG: 0 is fast, 9 is small.",
        least=0,
        most=9,
    ),
    ParameterRow(
        "compressed.depth_encoding",
        "32FC1",
        "Of depth on .../compressedDepth: 32FC1 rounds the inverse of depth to 16 bits, 16UC1 "
        "depth to millimetres.",
        choices=("32FC1", "16UC1"),
    ),
    ParameterRow(
        "compressed.depth_max_m",
        100.0,
        "Depth beyond it is sent compressed as no measurement.",
        unit="m",
        least=0.1,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "compressed.depth_quantization",
        100.0,
        "How finely 32FC1 is rounded, by z^2 / (2 q^2) metres at most; nearer than q^2 / 65535 "
        "metres it tells nothing.",
        least=1.0,
        most=10_000.0,
    ),
)

TRAJECTORY = (
    ParameterRow(
        "path.length",
        1000,
        "Poses that path holds; the oldest go first. 0: no path.",
        least=0,
        most=100_000,
    ),
    ParameterRow(
        "viewpoints.count",
        1000,
        "Frusta that viewpoints shows; the oldest go first. 0: none.",
        least=0,
        most=100_000,
    ),
    ParameterRow(
        "viewpoints.depth_m",
        0.5,
        "How deep a frustum is drawn.",
        unit="m",
        least=0.001,
        most=1000.0,
    ),
)

FAULTS = (
    ParameterRow(
        "faults.seed",
        0,
        "Root of all draws of faults: the same seed, batch, sample and sensor, the same faults.",
        least=0,
        most=2**63 - 1,
    ),
    ParameterRow(
        "faults.depth_noise",
        "none",
        "Law of the error of a depth z: gaussian has a standard deviation of depth_sigma_m, "
        "quadratic of depth_sigma_m + depth_sigma_per_m z^2, kinect that of structured light.",
        choices=("none", "gaussian", "quadratic", "kinect"),
    ),
    ParameterRow(
        "faults.depth_sigma_m",
        0.01,
        "See faults.depth_noise.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "faults.depth_sigma_per_m",
        0.001,
        "See faults.depth_noise.",
        unit="1/m",
        least=0.0,
        most=1000.0,
    ),
    ParameterRow(
        "faults.min_depth_m",
        0.0,
        "What is measured nearer is published as -inf.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "faults.max_depth_m",
        0.0,
        "What is measured farther is published as +inf; 0: no limit.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "faults.missing_ratio",
        0.0,
        "Share of depth pixels that are published as NaN.",
        least=0.0,
        most=1.0,
    ),
    ParameterRow(
        "faults.drift_m",
        0.0,
        "Standard deviation of what odometry drifts along each axis with every sample.",
        unit="m",
        least=0.0,
        most=1000.0,
    ),
    ParameterRow(
        "faults.drift_rad",
        0.0,
        "Standard deviation of what odometry turns about each axis with every sample.",
        unit="rad",
        least=0.0,
        most=3.2,
    ),
    ParameterRow(
        "faults.tf_drifts",
        False,
        "Whether the transform of the rig is that of odometry; false: it is the true one.",
    ),
)
