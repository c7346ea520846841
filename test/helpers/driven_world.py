"""A small world with two cameras, a lidar and an IMU, and a rover that drives for a second."""

from __future__ import annotations

from typing import Any

_CAMERA = {"width_px": 32, "height_px": 24, "fx_px": 27, "fy_px": 27, "modalities": ["depth"]}

DRIVEN_WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 40, "resolution_px": 65},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}},
    "assets": {"rocks": []},
    "sensors": {
        "cameras": [
            {"name": "front", "mount_position_m": [0.5, 0, 1.5], "rate_hz": 10.0, **_CAMERA},
            {"name": "side", "mount_position_m": [0, 0.4, 1.5], "rate_hz": 4.0, **_CAMERA},
        ],
        "lidars": [
            {"scan": {"kind": "raster", "columns": 8, "rows": 4}, "rate_hz": 5.0, "period_s": 0.1}
        ],
        "imus": [
            {
                "rate_hz": 100.0,
                "gyroscope_noise_density": 1e-4,
                "mount_position_m": [0.1, 0.0, 0.3],
                "mount_quat_xyzw": [0.0, 0.0, 0.6, 0.8],
            }
        ],
    },
    "drive": {
        "waypoints_m": [[-6, -4], [0, 0], [6, 1]],
        "duration_s": 1.0,
        "gravity": "moon",
        "odometry_rate_hz": 20.0,
    },
}

DUE = {"front": 10, "side": 4, "lidar": 5, "imu": 100, "odometry": 20}
"""Measurements of that drive; the lidar's last scan begins at 0.8 s."""

TOPIC_OF_SENSOR = {
    "front": "front/depth/image_raw",
    "side": "side/depth/image_raw",
    "lidar": "lidar/points",
    "imu": "imu/data_raw",
    "odometry": "ground_truth/odometry",
}
"""A topic of each sensor that has one message for each measurement."""
