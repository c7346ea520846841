"""Judges the sensors of a drive with odometry programs that others wrote: evo, KISS-ICP, GTSAM.

All of them run in processes of their own: none is imported beside a simulator.
"""
