"""The simulator's core: what a world is, how it is drawn from a seed, and how it is rendered."""

from oaisys_core.native_libraries import guard_open3d

guard_open3d()

__version__ = "0.1.0"
