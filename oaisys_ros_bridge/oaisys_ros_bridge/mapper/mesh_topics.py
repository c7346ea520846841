"""Topics ``~/mesh`` and ``~/surface_points``: the surface, small enough for a message."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from oaisys_core.errors import OaisysError
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.voxels.semantic_fusion import class_colors
from oaisys_ros_bridge.clouds import cloud_to_msg, mesh_to_marker
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.mapper.fusion import Fusion
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.qos import LATCHED_QOS


class MeshTopics:
    """Publishes the surface of the map.

    Args:
        node: The mapper.
        fusion: Has the map.
        settings: Returns the mapper's parameters.
    """

    def __init__(self, node: Node, fusion: Fusion, settings: Settings) -> None:
        self._node = node
        self._fusion = fusion
        self._settings = settings
        self._published_frames = 0
        self._mesh = node.create_publisher(Marker, "~/mesh", LATCHED_QOS)
        self._points = node.create_publisher(PointCloud2, "~/surface_points", LATCHED_QOS)

    def publish_new(self) -> None:
        """Publish the surface if it has changed and has subscribers."""
        publishers = (self._mesh, self._points)
        listeners = sum(publisher.get_subscription_count() for publisher in publishers)
        integrated = self._fusion.state.integrated
        if listeners == 0 or integrated == self._published_frames:
            return
        try:
            mesh = self._fusion.visible_surface()
        except OaisysError as error:
            self._node.get_logger().warning(f"no mesh: {error}")
            return
        self.publish(mesh)
        self._published_frames = integrated

    def publish(self, mesh: ColoredMesh) -> None:
        """Publish a surface; triangles are merged if there are too many for a message."""
        stamp = stamp_from_nanoseconds(self._fusion.state.stamp_ns)
        header = Header(stamp=stamp, frame_id=self._settings()["map_frame"])
        if self._settings()["mesh_colors"] == "class" and mesh.class_ids is not None:
            mesh = replace(mesh, colors_rgb=class_colors(mesh.class_ids))
        points = mesh.vertices_m.astype("float32")[None]
        self._points.publish(cloud_to_msg(points, mesh.colors_rgb[None], header))
        most, cell_m = self._settings()["mesh_triangles"], 2 * self._settings()["voxel_size"]
        small = at_most(mesh, most, cell_m)
        self._mesh.publish(
            mesh_to_marker(small.vertices_m, small.triangles, small.colors_rgb, header)
        )


def cluster_vertices(mesh: ColoredMesh, cell_m: float) -> ColoredMesh:
    """Return the mesh with one vertex per grid cell: the mean of the vertices in the cell.

    Vertex clustering as in Rossignac and Borrel, "Multi-resolution 3D approximations for rendering
    complex scenes", 1993. Triangles whose vertices lie in fewer than three cells are removed.
    """
    cells = np.floor(mesh.vertices_m / cell_m).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    x, y, z = cells.T
    _, height, depth = (cells.max(axis=0, initial=0) + 1).tolist()
    _, cluster = np.unique((x * height + y) * depth + z, return_inverse=True)
    cluster = cluster.ravel()
    count = np.bincount(cluster)[:, None]
    vertices_m = np.column_stack([np.bincount(cluster, v) for v in mesh.vertices_m.T]) / count
    colors = np.column_stack([np.bincount(cluster, c) for c in mesh.colors_rgb.T]) / count
    triangles = cluster[mesh.triangles]
    a, b, c = triangles.T
    kept = (a != b) & (b != c) & (c != a)
    return ColoredMesh(
        vertices_m, triangles[kept].astype(np.int32), np.rint(colors).astype(np.uint8)
    )


def at_most(mesh: ColoredMesh, triangles: int, cell_m: float) -> ColoredMesh:
    """Return the mesh, clustered if it has more than ``triangles`` triangles.

    Cells begin at ``cell_m`` and grow by half until the mesh is small enough.
    """
    small = mesh
    while len(small.triangles) > triangles:
        small = cluster_vertices(mesh, cell_m)
        cell_m *= 1.5
    return small
