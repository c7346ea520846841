"""Programs that others wrote judge cameras and their poses: COLMAP, Open3D, OpenCV.

Each runs in a process of its own, because its libraries do not get on with Blender's.
"""
