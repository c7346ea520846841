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
        "Nearer pixels, along the optical axis, become no points.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "cloud.max_depth_m",
        0.0,
        "Farther pixels, along the optical axis, become no points; 0: no limit.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "cloud.drop_sky",
        False,
        "Whether a cloud is one row of its valid points; false: it is organised as the image, with "
        "NaN where there is no point.",
    ),
)

COMPRESSED = (
    ParameterRow(
        "compressed.color_format",
        "jpeg",
        "Format of colour on .../compressed; labels and ids are always PNG, which is lossless.",
        choices=("jpeg", "png"),
    ),
    ParameterRow(
        "compressed.jpeg_quality",
        95,
        "Quality of JPEG.",
        least=1,
        most=100,
    ),
    ParameterRow(
        "compressed.png_level",
        1,
        "Compression level of PNG: 0 is fast, 9 is small.",
        least=0,
        most=9,
    ),
    ParameterRow(
        "compressed.depth_encoding",
        "32FC1",
        "Encoding of depth on .../compressedDepth: 32FC1 rounds inverse depth to 16 bits, 16UC1 "
        "rounds depth to millimetres.",
        choices=("32FC1", "16UC1"),
    ),
    ParameterRow(
        "compressed.depth_max_m",
        100.0,
        "In compressed images, depth beyond it is no measurement.",
        unit="m",
        least=0.1,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "compressed.depth_quantization",
        100.0,
        "Resolution q of 32FC1: the error is at most z^2 / (2 q^2) metres, and depth below "
        "q^2 / 65535 metres is no measurement.",
        least=1.0,
        most=10_000.0,
    ),
)

TRAJECTORY = (
    ParameterRow(
        "path.length",
        1000,
        "Most poses of path; the oldest are removed first. 0: no path.",
        least=0,
        most=100_000,
    ),
    ParameterRow(
        "viewpoints.count",
        1000,
        "Most frusta of viewpoints; the oldest are removed first. 0: none.",
        least=0,
        most=100_000,
    ),
    ParameterRow(
        "viewpoints.depth_m",
        0.5,
        "Depth of a frustum.",
        unit="m",
        least=0.001,
        most=1000.0,
    ),
)

FAULTS = (
    ParameterRow(
        "faults.seed",
        0,
        "Seed of all faults: the same seed, batch, sample and sensor give the same faults.",
        least=0,
        most=2**63 - 1,
    ),
    ParameterRow(
        "faults.depth_noise",
        "none",
        "Error of a depth z: gaussian has a standard deviation of depth_sigma_m, quadratic of "
        "depth_sigma_m + depth_sigma_per_m z^2, kinect that of structured light.",
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
        "Nearer measurements are published as -inf.",
        unit="m",
        least=0.0,
        most=FARTHEST_M,
    ),
    ParameterRow(
        "faults.max_depth_m",
        0.0,
        "Farther measurements are published as +inf; 0: no limit.",
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
        "Standard deviation of the drift of odometry along each axis, per sample.",
        unit="m",
        least=0.0,
        most=1000.0,
    ),
    ParameterRow(
        "faults.drift_rad",
        0.0,
        "Standard deviation of the drift of odometry about each axis, per sample.",
        unit="rad",
        least=0.0,
        most=3.2,
    ),
    ParameterRow(
        "faults.tf_drifts",
        False,
        "Whether the transform of the rig drifts as odometry does; false: it is the true one.",
    ),
)
