"""Errors of real depth sensors and of odometry, drawn from seeds.

Each error is a function of (seed, batch, sample, sensor) alone, so a sample that is rendered again
has the same errors. Each kind of error has its own random stream, so that switching one on does not
change the others.
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pixel_rays
from oaisys_core.types import DEPTH, RANGE, FloatArray, Frame, Odometry, Pose

DepthImage = NDArray[np.float32]
NoiseLaw = Literal["none", "gaussian", "quadratic", "kinect"]
NOISE_LAWS: tuple[NoiseLaw, ...] = ("none", "gaussian", "quadratic", "kinect")

KINECT_BASELINE_M = 0.075
"""Distance between the projector and the camera of a Kinect (first version)."""
KINECT_STEPS_PER_PX = 8
"""Resolution of disparities: an eighth of a pixel."""
KINECT_DISPARITY_SIGMA = 1 / 6
"""Standard deviation of a disparity before it is rounded, in steps of an eighth of a pixel."""
KINECT_LATERAL_SIGMA_PX = 0.5
"""Standard deviation of the lateral error of a pixel, which is rounded to whole pixels."""

WALK_CHUNK = 256
"""Number of samples by which a walk is continued at a time."""


class CaptureId(NamedTuple):
    """Identifies the images of one sensor at one sample."""

    batch_id: int
    sample_id: int
    sensor: str


@dataclass(frozen=True)
class DepthFaults:
    """Errors of a depth image; by default none.

    Attributes:
        seed: Root seed of the errors.
        noise: Law of the error of a depth z:

            * ``gaussian``: normal, mean 0, of standard deviation ``sigma_m`` at all depths.
            * ``quadratic``: normal, mean 0, of ``sigma_m + sigma_per_m * z**2``, as a stereo
              camera has it.
            * ``kinect``: structured light: a pixel measures a point beside it, and its disparity,
              with an error of its own, is rounded to an eighth of a pixel. Over depths that are
              far greater than their errors, these have a standard deviation of
              ``sqrt(1 / 36 + 1 / 12) = 1 / 3`` of a step, that is ``z**2 / (24 * fx * 0.075)``.
        sigma_m: See ``noise``.
        sigma_per_m: See ``noise``; 1/m.
        min_depth_m: Smaller measurements become ``-inf``.
        max_depth_m: Larger measurements become ``+inf``; 0: no limit.
        missing_ratio: Share of pixels that become NaN, drawn one by one.
    """

    seed: int = 0
    noise: NoiseLaw = "none"
    sigma_m: float = 0.01
    sigma_per_m: float = 0.001
    min_depth_m: float = 0.0
    max_depth_m: float = 0.0
    missing_ratio: float = 0.0

    @property
    def active(self) -> bool:
        """Whether there is any error."""
        return (
            self.noise != "none"
            or self.min_depth_m > 0
            or self.max_depth_m > 0
            or self.missing_ratio > 0
        )


def generator(seed: int, purpose: str, *capture: int | str) -> np.random.Generator:
    """Return the random generator of one kind of error in one image."""
    name = "/".join(map(str, (purpose, *capture))).encode()
    key = int.from_bytes(hashlib.sha256(name).digest()[:16], "big")
    return np.random.default_rng(np.random.SeedSequence([seed, key]))


def measure_depth(
    depth_m: DepthImage, fx_px: float, faults: DepthFaults, capture: CaptureId
) -> DepthImage:
    """Return the depth image that a faulty sensor measures of a true (H, W) planar depth image.

    ``+inf`` (nothing there) stays ``+inf`` unless the pixel goes missing. Limits apply to the noisy
    depth; missing pixels are drawn last. As in REP-117, ``-inf`` is too near, ``+inf`` is too far,
    and NaN is no measurement.

    Args:
        depth_m: True depth; it is not changed.
        fx_px: Focal length, for the disparities of ``kinect``.
        faults: The errors.
        capture: Identifies the image.
    """
    if not faults.active:
        return depth_m
    measured_m = _with_noise(depth_m, fx_px, faults, capture)
    if measured_m is depth_m:
        measured_m = depth_m.copy()
    if faults.min_depth_m > 0:
        measured_m[measured_m < faults.min_depth_m] = -np.inf
    if faults.max_depth_m > 0:
        measured_m[measured_m > faults.max_depth_m] = np.inf
    if faults.missing_ratio > 0:
        draws = generator(faults.seed, "missing", *capture).random(depth_m.shape, dtype=np.float32)
        measured_m[draws < faults.missing_ratio] = np.nan
    return measured_m


def measure_frame(frame: Frame, faults: DepthFaults, capture: CaptureId) -> Frame:
    """Return the frame that a faulty sensor measures instead of the true one.

    Depth and range have the same errors; other modalities have none, `DEPTH_TRUE` and `RANGE_TRUE`
    among them.
    """
    if frame.modality not in (DEPTH, RANGE) or not faults.active:
        return frame
    fx_px = frame.intrinsics.fx_px
    if frame.modality == DEPTH:
        return replace(frame, data=measure_depth(frame.data, fx_px, faults, capture))
    lengths = np.linalg.norm(pixel_rays(frame.intrinsics), axis=-1)
    depth_m = (frame.data / lengths).astype(np.float32)
    range_m = measure_depth(depth_m, fx_px, faults, capture) * lengths
    return replace(frame, data=range_m.astype(np.float32))


def _with_noise(
    depth_m: DepthImage, fx_px: float, faults: DepthFaults, capture: CaptureId
) -> DepthImage:
    if faults.noise == "none":
        return depth_m
    if faults.noise == "kinect":
        return _by_structured_light(depth_m, fx_px, faults.seed, capture)
    rng = generator(faults.seed, "noise", *capture)
    error_m = rng.standard_normal(depth_m.shape, dtype=np.float32)
    if faults.noise == "gaussian":
        error_m *= np.float32(faults.sigma_m)
    else:
        z = np.where(np.isfinite(depth_m), depth_m, np.float32(0))
        error_m *= np.float32(faults.sigma_m) + np.float32(faults.sigma_per_m) * z * z
    error_m += depth_m
    return _too_near_where_not_positive(error_m)


def _by_structured_light(
    depth_m: DepthImage, fx_px: float, seed: int, capture: CaptureId
) -> DepthImage:
    height, width = depth_m.shape
    lateral = generator(seed, "lateral", *capture)
    rows, columns = (
        np.rint(lateral.standard_normal(depth_m.shape, np.float32) * KINECT_LATERAL_SIGMA_PX)
        for _ in range(2)
    )
    rows += np.arange(height, dtype=np.float32)[:, None]
    columns += np.arange(width, dtype=np.float32)
    beside = np.clip(rows, 0, height - 1).astype(np.intp) * width
    beside += np.clip(columns, 0, width - 1).astype(np.intp)
    steps_m = np.float32(KINECT_STEPS_PER_PX * fx_px * KINECT_BASELINE_M)
    seen_m = depth_m.ravel()[beside]
    disparity = generator(seed, "noise", *capture).standard_normal(depth_m.shape, np.float32)
    disparity *= np.float32(KINECT_DISPARITY_SIGMA)
    with np.errstate(divide="ignore"):
        disparity += steps_m / seen_m
        np.rint(disparity, out=disparity)
        measured_m = steps_m / np.maximum(disparity, np.float32(0))
    measured_m[np.isinf(seen_m)] = np.inf
    return measured_m


def _too_near_where_not_positive(measured_m: DepthImage) -> DepthImage:
    measured_m[measured_m <= 0] = -np.inf
    return measured_m


class PoseDrift:
    """Random walks of a pose, which drifts with every sample of a batch.

    The first sample of a batch has no error. At sample n, the errors of x, y, z and of rotations
    about the map's axes are normal with ``sqrt(n - 1)`` times the standard deviation of a step.
    Safe to use from several threads.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._walk: tuple[tuple[int, int], np.random.Generator, FloatArray] | None = None

    def unit_walk(self, seed: int, batch_id: int, sample_id: int) -> FloatArray:
        """Return the (6,) sum of ``sample_id - 1`` standard normal steps; 0 before sample 1."""
        with self._lock:
            key = (seed, batch_id)
            if self._walk is None or self._walk[0] != key:
                self._walk = (key, generator(seed, "drift", batch_id), np.zeros((1, 6)))
            _, rng, sums = self._walk
            if len(sums) < sample_id:
                chunks = -(-(sample_id - len(sums)) // WALK_CHUNK)
                steps = rng.standard_normal((chunks * WALK_CHUNK, 6))
                # Steps are added one by one, so that no bit of a sum depends on the chunks.
                more = np.cumsum(np.concatenate((sums[-1:], steps)), axis=0)
                sums = np.concatenate((sums, more[1:]))
            self._walk = (key, rng, sums)
            there: FloatArray = sums[max(sample_id, 1) - 1]
            return there

    def estimate(
        self, pose: Pose, sigmas: tuple[float, float], seed: int, batch_id: int, sample_id: int
    ) -> Pose:
        """Return the pose that a robot estimates instead of the true one.

        Args:
            pose: True pose in ``map``.
            sigmas: Standard deviation of a sample's step along each axis (m) and about it (rad).
            seed: Root seed of the drift.
            batch_id: Id of the batch.
            sample_id: Id of the sample in the batch.
        """
        from scipy.spatial.transform import Rotation

        step_m, step_rad = sigmas
        if not (step_m or step_rad):
            return pose
        walk = self.unit_walk(seed, batch_id, sample_id)
        x, y, z = (float(v) for v in np.asarray(pose.position_m) + step_m * walk[:3])
        turned = Rotation.from_rotvec(step_rad * walk[3:]) * Rotation.from_quat(pose.quat_xyzw)
        qx, qy, qz, qw = (float(v) for v in turned.as_quat(canonical=True))
        return Pose((x, y, z), (qx, qy, qz, qw))

    def odometry(
        self, pose: Pose, sigmas: tuple[float, float], seed: int, batch_id: int, sample_id: int
    ) -> Odometry:
        """Return the drifted pose with its standard deviations; see `estimate`."""
        root = (max(sample_id, 1) - 1) ** 0.5
        drifted = self.estimate(pose, sigmas, seed, batch_id, sample_id)
        return Odometry(drifted, sigmas[0] * root, sigmas[1] * root)


def drift_covariance(sigmas: tuple[float, float], sample_id: int) -> NDArray[Any]:
    """Return the (36,) row-major covariance of x, y, z and turns about x, y, z at a sample."""
    step_m, step_rad = sigmas
    steps = max(sample_id, 1) - 1
    variances = np.repeat((steps * step_m**2, steps * step_rad**2), 3)
    return np.diag(variances).ravel()


def odometry_covariance(odometry: Odometry) -> NDArray[Any]:
    """Return the (36,) row-major covariance of a sample's odometry, see `drift_covariance`."""
    variances = np.repeat((odometry.sigma_m**2, odometry.sigma_rad**2), 3)
    return np.diag(variances).ravel()
