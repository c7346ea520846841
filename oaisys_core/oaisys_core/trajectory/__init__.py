"""Trajectories: the rig's pose as a function of time, and the vehicles that plan them.

A motion from sample to sample, without time, is in `sample_poses`; what sensors measure on a
trajectory is in `oaisys_core.drive`.
"""

from oaisys_core.scene.rig_motion import RigMotion
from oaisys_core.trajectory.trajectory import Trajectory, TransformAt

__all__ = ["RigMotion", "Trajectory", "TransformAt"]
