"""The base class of motions, and the functions that they share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core import geometry
from oaisys_core.config.sections.sensing.motion import AnglesConfig, MotionConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import Ground
from oaisys_core.types import FloatArray, Georeference, Pose

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

VERTICAL_COSINE = 1 - 1e-9
"""For viewing directions closer to the vertical than this, the image's upper edge points to +x."""

MAX_DRAWS = 64
"""Number of poses that a motion may draw for one sample."""

STREAM = "sensors.motion"
"""Name of the random stream of motions."""


@dataclass(frozen=True)
class MotionStep:
    """One step of a motion, and what it may use.

    Attributes:
        index: Index of the step, from 0.
        rng: Generator of this step.
        batch_rng: Generator that is in the same state at each step of the batch.
        ground: The ground of the batch.
        locate: Returns the (3,) position of the object with an instance id.
        georeference: Where the ground lies on its body; None if it is of no place.
    """

    index: int
    rng: np.random.Generator
    batch_rng: np.random.Generator
    ground: Ground
    locate: Callable[[int], FloatArray]
    georeference: Georeference | None = None


class Motion(ABC):
    """A motion of the rig.

    Attributes:
        step_interval: Number of samples for which the rig keeps each pose.
        can_redraw: Whether `pose` returns another pose when it is called again.
        is_lifted: Whether a pose too close to a surface is lifted instead of refused.
    """

    step_interval: int = 1
    can_redraw: bool = False
    is_lifted: bool = False

    @abstractmethod
    def pose(self, step: MotionStep) -> Pose | None:
        """Return the pose of the rig, or None if it needs ground that is not there.

        Raises:
            InvalidInputError: There is no such step, or no such target.
        """

    def first_admitted_pose(self, step: MotionStep, admitted: Callable[[Pose], Pose]) -> Pose:
        """Return the first pose of a step that is admitted; up to `MAX_DRAWS` are drawn.

        Args:
            step: The step.
            admitted: Returns the pose, possibly moved, or raises `InvalidInputError`.

        Raises:
            InvalidInputError: No pose was admitted, or the motion has ended.
        """
        reason = "the motion leaves the stage"
        draws = MAX_DRAWS if self.can_redraw else 1
        for _ in range(draws):
            pose = self.pose(step)
            if pose is None:
                continue
            try:
                return admitted(pose)
            except InvalidInputError as error:
                reason = f"pose.position {error.received} does not have {error.expected}"
        tries = f"{draws} draws" if draws > 1 else "its only pose"
        expected = f"a pose that sensors.pose_policy accepts ({tries}; {reason})"
        raise InvalidInputError("sensors.motion", f"step {step.index + 1}", expected)


def draw_from(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Return a number drawn uniformly from a range."""
    return float(rng.uniform(*bounds))


def at_height(
    position_m: FloatArray, config: MotionConfig, step: MotionStep, rng: np.random.Generator
) -> FloatArray | None:
    """Return a (3,) position at the height that ``config`` asks for; None if there is no ground."""
    if config.height_above_ground_m is None:
        return position_m
    above_m = draw_from(config.height_above_ground_m, rng)
    above_m += config.height_noise_m * float(rng.standard_normal())
    return on_ground(position_m, above_m, step.ground)


def on_ground(position_m: FloatArray, above_m: float, ground: Ground) -> FloatArray | None:
    """Return a (3,) position moved to ``above_m`` above the ground; None if there is no ground."""
    height_m = float(ground.height_at(position_m[None, :2])[0]) + above_m
    return np.array((*position_m[:2], height_m)) if isfinite(height_m) else None


def attitude(config: AnglesConfig, rng: np.random.Generator) -> Rotation:
    """Draw a rotation of the rig in ``map``."""
    from scipy.spatial.transform import Rotation

    angles_deg = [
        draw_from(ranges, rng) for ranges in (config.roll_deg, config.pitch_deg, config.yaw_deg)
    ]
    rest_deg = 90.0 if config.look == "down" else 0.0
    turned = Rotation.from_euler("xyz", angles_deg, degrees=True)
    return turned * Rotation.from_euler("y", rest_deg, degrees=True)


def pose_of(position_m: FloatArray, rotation: Rotation) -> Pose:
    """Return the pose with a (3,) position and a rotation."""
    return geometry.pose_from_matrix(geometry.transform(rotation.as_matrix(), position_m))


def looking_at(eye_m: FloatArray, target_m: FloatArray, roll_deg: float = 0.0) -> Pose:
    """Return the pose at ``eye_m`` that looks at ``target_m``, rolled about that direction.

    Raises:
        InvalidInputError: Both are the same point.
    """
    from scipy.spatial.transform import Rotation

    way_m = target_m - eye_m
    distance_m = float(np.linalg.norm(way_m))
    if distance_m < 1e-6:
        raise InvalidInputError(
            "sensors.motion", eye_m.tolist(), "a position of the rig that is not its target"
        )
    is_vertical = abs(way_m[2]) / distance_m > VERTICAL_COSINE
    up = (1.0, 0.0, 0.0) if is_vertical else (0.0, 0.0, 1.0)
    pose = geometry.pose_looking_at(eye_m, target_m, up)
    roll = Rotation.from_euler("x", roll_deg, degrees=True)
    x, y, z, w = (Rotation.from_quat(pose.quat_xyzw) * roll).as_quat(canonical=True).tolist()
    return replace(pose, quat_xyzw=(x, y, z, w))


def index_in(index: int, count: int, at_end: str, what: str) -> int:
    """Return which of ``count`` poses or places a step takes.

    Raises:
        InvalidInputError: The step is beyond the last one, and ``at_end`` is ``refuse``.
    """
    if index < count or at_end == "repeat":
        return index % count
    if at_end == "refuse":
        raise InvalidInputError("sensors.motion", f"step {index + 1}", f"one of the {count} {what}")
    return count - 1
