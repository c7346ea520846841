"""Programs that others wrote judge cameras, poses and light: COLMAP, Open3D, OpenCV, Mitsuba.

Each runs in a process of its own, because its libraries do not get on with Blender's.
"""
