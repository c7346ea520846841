"""The views of the demo's world that the benchmarks render."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import FloatArray, Pose

Heights = Callable[[list[tuple[float, float, float]]], FloatArray]
"""Surface heights under (x, y, z) points."""

NOON = {"sun_elevation_deg": 38.0, "sun_strength_w_m2": 4.0}


@dataclass(frozen=True)
class PosedView:
    """The pose of a rig with its light.

    Attributes:
        name: For files and figures.
        pose: ``T_map_base`` of the rig.
        environment, render: Metadata of the sample, besides its quality.
    """

    name: str
    pose: Pose
    environment: Mapping[str, Any] = field(default_factory=dict)
    render: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON-able data; inverse: `from_dict`."""
        return {
            "name": self.name,
            "position_m": list(self.pose.position_m),
            "quat_xyzw": list(self.pose.quat_xyzw),
            "environment": dict(self.environment),
            "render": dict(self.render),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> PosedView:
        """Return what `to_dict` was called on."""
        pose = Pose(tuple(data["position_m"]), tuple(data["quat_xyzw"]))
        return cls(data["name"], pose, data["environment"], data["render"])


@dataclass(frozen=True)
class BenchView:
    """A camera position, its target, and its light.

    Attributes:
        eye_xy_m, eye_rise_m: Position, and height above the surface there.
        target_xy_m: Point to look at; None: straight down.
        target_rise_m: Height of the target above the surface there.
        environment, render: Metadata in addition to that of all views.
    """

    name: str
    eye_xy_m: tuple[float, float]
    eye_rise_m: float
    target_xy_m: tuple[float, float] | None = None
    target_rise_m: float = 0.0
    environment: Mapping[str, Any] = field(default_factory=dict)
    render: Mapping[str, Any] = field(default_factory=dict)

    def pose(self, heights_m: Heights, offset_m: float = 0.0) -> Pose:
        """Return the rig's pose, moved ``offset_m`` metres to the east."""
        x, y = self.eye_xy_m
        x += offset_m
        target = self.target_xy_m or (x, y)
        # To a millimetre, so that ray casters whose last digits differ agree on the pose.
        surface_m = np.round(heights_m([(x, y, 0.0), (*target, 0.0)]), 3)
        eye_z = float(surface_m[0]) + self.eye_rise_m
        if self.target_xy_m is None:
            return pose_looking_down(x, y, eye_z)
        return pose_looking_at((x, y, eye_z), (*target, float(surface_m[1]) + self.target_rise_m))

    def with_pose(self, heights_m: Heights) -> PosedView:
        """Return the view at its pose, lit from noon's sun where it does not say otherwise."""
        light = {**NOON, **self.environment}
        # Settings persist in a simulation, so each view sets all of them.
        render = {"exposure_ev": 0.0, **self.render}
        return PosedView(self.name, self.pose(heights_m), light, render)


VIEWS = (
    BenchView("nadir", (3, 4), 10.0),
    BenchView("oblique", (-14, -10), 6.0, (4, 4)),
    BenchView("low_sun", (12, -12), 4.0, (0, 2), environment={"sun_elevation_deg": 8.0}),
    BenchView("close_up", (5, -3), 1.2, (7, -1.5)),
    BenchView("horizon", (-20, 0), 2.0, (20, 5), 1.5),
    # Lit by the sky alone, with a longer exposure.
    BenchView(
        "shadow",
        (12, 12),
        5.0,
        (0, 0),
        environment={"sun_strength_w_m2": 0.0},
        render={"exposure_ev": 2.6},
    ),
)


def by_light(views: Sequence[PosedView]) -> list[list[PosedView]]:
    """Return views in groups of the same light, because a change of light takes seconds."""
    groups: dict[str, list[PosedView]] = {}
    for view in views:
        groups.setdefault(str((view.environment, view.render)), []).append(view)
    return list(groups.values())


def random_poses(
    count: int, extent_m: tuple[float, float, float, float], heights_m: Heights, seed: int = 0
) -> list[Pose]:
    """Return poses 1.5 to 12 m above the surface that look at it, from steep to nearly level."""
    rng = np.random.default_rng(seed)
    x0, y0, x1, y1 = extent_m
    middle, half = np.array((x0 + x1, y0 + y1)) / 2, np.array((x1 - x0, y1 - y0)) / 2
    poses = []
    for _ in range(count):
        eye = middle + half * rng.uniform(-0.7, 0.7, 2)
        heading = rng.uniform(0, 2 * np.pi)
        target = eye + rng.uniform(2, 12) * np.array((np.cos(heading), np.sin(heading)))
        target = np.clip(target, middle - 0.95 * half, middle + 0.95 * half)
        surface_m = heights_m([(*eye.tolist(), 0.0), (*target.tolist(), 0.0)])
        eye_z = float(surface_m[0]) + rng.uniform(1.5, 12)
        poses.append(
            pose_looking_at((*eye.tolist(), eye_z), (*target.tolist(), float(surface_m[1])))
        )
    return poses
