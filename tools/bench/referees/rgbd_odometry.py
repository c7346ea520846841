"""Open3D's RGB-D odometry from each picture of a flight to the next, against the true motion.

``python -m tools.bench.referees.rgbd_odometry FILE.npz`` prints the figures as JSON.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oaisys_core.types import FloatArray, Frame
from tools.bench.referees.module_process import run_for_json

MAX_DEPTH_M = 60.0
MAX_STEP_M = 0.5
"""Difference of two depths above which pixels are not taken for the same point."""


@dataclass(frozen=True)
class RgbdFigures:
    """How well the motion between pictures is found.

    Attributes:
        pairs, found: Pairs of pictures, and those whose motion the program says to have found.
        step_m: Median distance between two pictures.
        error_share: Median relative error of the motion, as a share of that distance.
        error_deg: Median angle between the rotation that was found and the true one.
    """

    pairs: int
    found: int
    step_m: float
    error_share: float
    error_deg: float


def rgbd_figures(colour: Sequence[Frame], depth: Sequence[Frame]) -> RgbdFigures:
    """Return what Open3D makes of a flight, in a process of its own.

    Args:
        colour, depth: Frames of one camera, in the order of time; depth is along z.

    Raises:
        ProgramError: Open3D failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "flight.npz")
        np.savez(
            file,
            colour=np.array([frame.data for frame in colour]),
            depth_m=np.array([frame.data for frame in depth], np.float32),
            T=np.array([frame.T_map_camera for frame in colour]),
            K=colour[0].intrinsics.K,
        )
        return RgbdFigures(**run_for_json(__name__, str(file)))


def _figures(data: Any) -> RgbdFigures:
    T: FloatArray = data["T"]
    pictures = [_picture(c, d) for c, d in zip(data["colour"], data["depth_m"], strict=True)]
    camera = _camera(data["K"], data["depth_m"].shape[1:])
    steps_m, shares, angles_deg = [], [], []
    for i in range(len(pictures) - 1):
        succeeded, T_after_before = _find_motion(pictures[i], pictures[i + 1], camera)
        if not succeeded:
            continue
        true = np.linalg.inv(T[i + 1]) @ T[i]
        error = np.linalg.inv(true) @ T_after_before
        steps_m.append(float(np.linalg.norm(T[i + 1, :3, 3] - T[i, :3, 3])))
        shares.append(float(np.linalg.norm(error[:3, 3])) / steps_m[-1])
        angles_deg.append(float(np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude())))
    medians = [float(np.median(each)) for each in (steps_m, shares, angles_deg)]
    return RgbdFigures(len(pictures) - 1, len(steps_m), *medians)


def _picture(colour: Any, depth_m: Any) -> Any:
    import open3d

    depth = np.where(np.isfinite(depth_m), depth_m, 0).astype(np.float32)
    return open3d.geometry.RGBDImage.create_from_color_and_depth(
        open3d.geometry.Image(np.ascontiguousarray(colour)),
        open3d.geometry.Image(depth),
        depth_scale=1.0,
        depth_trunc=MAX_DEPTH_M,
        convert_rgb_to_intensity=True,
    )


def _camera(K: FloatArray, size_px: Sequence[int]) -> Any:
    import open3d

    height_px, width_px = size_px
    return open3d.camera.PinholeCameraIntrinsic(
        width_px, height_px, K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    )


def _find_motion(before: Any, after: Any, camera: Any) -> tuple[bool, FloatArray]:
    """Return whether the motion was found, and the transform from one camera to the next."""
    import open3d

    odometry = open3d.pipelines.odometry
    option = odometry.OdometryOption(depth_diff_max=MAX_STEP_M, depth_max=MAX_DEPTH_M)
    succeeded, T, _ = odometry.compute_rgbd_odometry(
        before,
        after,
        camera,
        np.eye(4),
        odometry.RGBDOdometryJacobianFromHybridTerm(),
        option,
    )
    return bool(succeeded), np.asarray(T)


def main() -> None:
    """Print the figures of a file as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    with np.load(parser.parse_args().file) as data:
        print(json.dumps(asdict(_figures(data))))


if __name__ == "__main__":
    main()
