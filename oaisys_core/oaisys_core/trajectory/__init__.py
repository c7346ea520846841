"""Motion in time: trajectories, and the vehicles that plan them."""

from oaisys_core.scene.rig_motion import RigMotion
from oaisys_core.trajectory.trajectory import Trajectory, TransformAt

__all__ = ["RigMotion", "Trajectory", "TransformAt"]
