"""Services about the true ground: heights under points, its surface, and where it lies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rclpy.node import Node
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError, NotReadyError, OaisysError
from oaisys_core.files.folders import user_file
from oaisys_core.files.whole_files import check_output_file
from oaisys_core.geometry import places
from oaisys_core.types import FloatArray, Georeference, TriangleMesh
from oaisys_mapping.evaluation.truth_io import write_truth
from oaisys_msgs.msg import SemanticLabel
from oaisys_msgs.srv import FromLonLat, GetGroundTruthMesh, QueryHeight, ToLonLat
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.conversions import array_of
from oaisys_ros_bridge.services import NodeServices

MAX_POINTS = 1_000_000
"""Of one request."""
MAX_MESH_BYTES = 1_000_000_000
"""Of a mesh in an answer; a larger one is written to a file."""
TRUTH_SUFFIXES = (".ply",)
"""Of that file."""


class GroundServices:
    """Offers the services; each has a queue of its own, as its answer may wait for a render.

    Args:
        node: The bridge.
        services: Of the bridge.
        render_queue: Knows the simulator and the frames.
        now: Returns the bridge's own time.
    """

    def __init__(
        self,
        node: Node,
        services: NodeServices,
        render_queue: RenderQueue,
        now: Callable[[], Time],
    ) -> None:
        self._node = node
        self._render_queue = render_queue
        self._now = now
        offered: tuple[tuple[Any, str, Callable[..., None]], ...] = (
            (QueryHeight, "~/query_height", self._query_height),
            (GetGroundTruthMesh, "~/get_ground_truth_mesh", self._get_mesh),
            (ToLonLat, "~/to_lon_lat", self._to_lon_lat),
            (FromLonLat, "~/from_lon_lat", self._from_lon_lat),
        )
        for kind, name, fill in offered:
            services.offer(kind, name, self._answer(name, fill))

    def _answer(self, name: str, fill: Callable[..., None]) -> Callable[[Any, Any], Any]:
        """Return the callback of a service; an error becomes its message."""

        def answer(request: Any, response: Any) -> Any:
            try:
                fill(request, response)
                response.success = True
            except (OaisysError, OSError, ValueError) as error:
                response = type(response)(message=str(error))
                self._node.get_logger().warning(f"{name} failed: {error}")
            return response

        return answer

    def _query_height(self, request: QueryHeight.Request, response: QueryHeight.Response) -> None:
        in_map_m = self._in_map_m(request)
        found = self._render_queue.require_link().query_height(in_map_m)
        response.header = self._header()
        # rclpy takes seconds to check a million numbers of another kind of array.
        response.ground_height = array_of("d", found.ground_height_m)
        response.surface_height = array_of("d", found.surface_height_m)
        response.clearance = array_of("d", found.clearance_m)

    def _get_mesh(
        self, request: GetGroundTruthMesh.Request, response: GetGroundTruthMesh.Response
    ) -> None:
        link = self._render_queue.require_link()
        batch_id, mesh = link.ground_truth_mesh()
        response.header = self._header()
        response.batch_id = batch_id
        response.vertex_count, response.triangle_count = len(mesh.vertices_m), len(mesh.triangles)
        names = sorted(link.info.semantic_labels.items())
        response.labels = [SemanticLabel(id=i, name=name) for i, name in names]
        if request.path:
            path = user_file(request.path, "path", TRUTH_SUFFIXES)
            write_truth(check_output_file(path, "path"), mesh)
        else:
            _fill_mesh(mesh, response)

    def _to_lon_lat(self, request: ToLonLat.Request, response: ToLonLat.Response) -> None:
        georeference = self._georeference()
        found = places.places_of(georeference, self._in_map_m(request))
        response.longitude, response.latitude, response.elevation = (
            array_of("d", column) for column in found.T
        )
        response.reference_system = georeference.wkt

    def _from_lon_lat(self, request: FromLonLat.Request, response: FromLonLat.Response) -> None:
        georeference = self._georeference()
        points_m = places.points_in_map(georeference, _places(request))
        if not request.elevation and len(points_m):
            found = self._render_queue.require_link().query_height(points_m)
            points_m[:, 2] = found.ground_height_m
        response.header = self._header()
        response.points = [Point(x=x, y=y, z=z) for x, y, z in points_m.tolist()]

    def _georeference(self) -> Georeference:
        """Return where the stage lies.

        Raises:
            NotReadyError: It lies nowhere.
        """
        found = self._render_queue.require_link().info.georeference
        if found is None:
            raise NotReadyError(
                "the stage lies on no body: received none, expected stage.dem with a reference"
                " system, without spacing_m and size_m"
            )
        return found

    def _in_map_m(self, request: Any) -> FloatArray:
        """Return the (N, 3) points of a request in ``map``."""
        points_m = _points(request.points)
        T_map_frame = self._render_queue.frames.transform_to_map(request.header, "header")
        return np.asarray(points_m @ T_map_frame[:3, :3].T + T_map_frame[:3, 3])

    def _header(self) -> Header:
        return Header(stamp=self._now(), frame_id=self._render_queue.map_frame)


def _places(request: FromLonLat.Request) -> FloatArray:
    """Return the (N, 3) longitudes, latitudes and elevations of a request; these are 0 by default.

    Raises:
        InvalidInputError: They are too many, of different numbers, or no places.
    """
    lon, lat = request.longitude, request.latitude
    elevation = request.elevation or [0.0] * len(lon)
    if not len(lon) == len(lat) == len(elevation) <= MAX_POINTS:
        received = f"{len(lon)} longitudes, {len(lat)} latitudes, {len(elevation)} elevations"
        expected = f"as many of each (or no elevations), at most {MAX_POINTS}"
        raise InvalidInputError("longitude, latitude, elevation", received, expected)
    found = np.column_stack((lon, lat, elevation)).astype(np.float64)
    is_wrong = ~np.isfinite(found).all(axis=1) | (np.abs(found[:, 1]) > 90.0)
    is_wrong |= np.abs(found[:, 0]) > 360.0
    wrong = np.flatnonzero(is_wrong)
    if len(wrong):
        expected = "finite, longitude from -360 to 360 and latitude from -90 to 90 degrees"
        raise InvalidInputError(f"place {wrong[0]}", found[wrong[0]].tolist(), expected)
    return found


def _points(points: list[Any]) -> FloatArray:
    """Return the (N, 3) coordinates of points.

    Raises:
        InvalidInputError: There are too many, or one is not finite.
    """
    if len(points) > MAX_POINTS:
        raise InvalidInputError("points", f"{len(points)} points", f"at most {MAX_POINTS}")
    points_m = np.array([(p.x, p.y, p.z) for p in points], np.float64).reshape(-1, 3)
    wrong = np.flatnonzero(~np.isfinite(points_m).all(axis=1))
    if len(wrong):
        received = points_m[wrong[0]].tolist()
        raise InvalidInputError(f"points[{wrong[0]}]", received, "finite coordinates")
    return points_m


def _fill_mesh(mesh: TriangleMesh, response: GetGroundTruthMesh.Response) -> None:
    """Write the arrays of a mesh into an answer.

    Raises:
        InvalidInputError: They do not fit into a message.
    """
    ids = [each for each in (mesh.semantic_ids, mesh.instance_ids) if each is not None]
    size = sum(each.nbytes for each in (mesh.vertices_m, mesh.triangles, *ids))
    if size > MAX_MESH_BYTES:
        expected = f"a file: the mesh has {size} bytes, and a message at most {MAX_MESH_BYTES}"
        raise InvalidInputError("path", "", expected)
    response.vertices = array_of("d", np.asarray(mesh.vertices_m, np.float64))
    response.triangles = array_of("I", np.asarray(mesh.triangles, np.uint32))
    if mesh.semantic_ids is not None:
        response.semantic_ids = array_of("H", np.asarray(mesh.semantic_ids, np.uint16))
    if mesh.instance_ids is not None:
        response.instance_ids = array_of("I", np.asarray(mesh.instance_ids, np.uint32))
