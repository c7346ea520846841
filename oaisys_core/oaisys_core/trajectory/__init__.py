"""Motion in time: trajectories, and the vehicles that plan them."""

from oaisys_core.trajectory.trajectory import Trajectory, TransformAt

__all__ = ["Trajectory", "TransformAt"]
