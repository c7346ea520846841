"""A live web page of the simulator's output: cameras, images, point clouds, the mesh."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Mapping
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import viser
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.files.markdown import escape_markdown
from oaisys_core.files.whole_files import write_whole_text
from oaisys_core.geometry import depth_to_points, pose_from_matrix
from oaisys_core.types import FloatArray, ShortRepr
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report import pictures
from oaisys_mapping.report.bad_messages import BadMessages
from oaisys_mapping.report.mesh_viewer import decimate
from oaisys_mapping.report.page_guard import PageGuard
from oaisys_mapping.report.unlit_mesh import unlit_glb

MAX_CAMERAS = 200
"""Cameras that are shown; the oldest ones are removed."""

MAX_POINTS = 80_000
"""Points of a view's cloud."""

MAX_TRIANGLES = 200_000
"""Triangles of the mesh, all of which are sent at each change."""

THUMBNAIL_WIDTH_PX = 160
FRUSTUM_M = 1.0
"""Length of a drawn camera frustum."""

OVERVIEW_M = (-22.0, -28.0, 22.0)
"""Initial position of the browser's camera, which looks at the origin."""


@dataclass(frozen=True, repr=False)
class PosedImages(ShortRepr):
    """The images of one view, with camera and pose.

    Attributes:
        name: Name of the view; it replaces a view of the same name.
        rgb: (H, W, 3) uint8, or None.
        depth_m: (H, W) float32 planar depth, or None; values that are not finite are left out.
        semantic_ids: (H, W) uint16, or None.
        camera: The camera and its pose.
        instance_ids: (H, W) uint32, or None.
    """

    name: str
    rgb: NDArray[np.uint8] | None
    depth_m: NDArray[np.float32] | None
    semantic_ids: NDArray[np.uint16] | None
    camera: PosedCamera
    instance_ids: NDArray[np.uint32] | None = None


class WebViewer:
    """Serves the page; use it in a ``with`` block.

    Attributes:
        labels: Names of semantic ids, whose order determines their colours.
    """

    def __init__(self, host: str, port: int, max_range_m: float) -> None:
        """Start to serve an empty page.

        Args:
            host: Address to listen on.
            port: Port; 0 or a used one: the next free one.
            max_range_m: Depth beyond which points are left out of clouds.

        Raises:
            OaisysError: The page would be without its guard.
        """
        self._guard = PageGuard(host)
        self._bad_messages = BadMessages()
        self._server = self._start_server(host, port)
        self._max_range_m = max_range_m
        self.labels: Mapping[int, str] = {}
        self._cameras: deque[Any] = deque()
        self._mesh: Any = None
        self._cloud: Any = None
        self._view_count = 0
        self._images: dict[str, Any] = {}
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.world_axes.visible = True
        scene.configure_environment_map(None)  # it would be added to the mesh's own colours
        self._server.initial_camera.position = OVERVIEW_M
        self._server.initial_camera.look_at = (0.0, 0.0, 0.0)
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)  # it opens a public tunnel
        gui.main_panel.dock_right()
        self._description = self._server.gui.add_markdown("Waiting for a view.")
        self._checkboxes = {
            name: self._server.gui.add_checkbox(name, initial_value=True)
            for name in ("mesh", "cloud", "cameras")
        }
        for box in self._checkboxes.values():
            box.on_update(self._update_visibility)

    def _start_server(self, host: str, port: int) -> viser.ViserServer:
        server = None
        # Browsers go at any moment.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        with redirect_stdout(StringIO()):
            try:
                with self._guard.install(self._bad_messages.is_used):
                    server = viser.ViserServer(host=host, port=port, label="OAISYS", verbose=False)
            except OaisysError:
                if server is not None:
                    server.stop()
                raise
        return server

    def __enter__(self) -> Self:
        """Return the viewer."""
        self._bad_messages.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop serving."""
        self._guard.tell(at_once=True)
        self._bad_messages.stop()
        with redirect_stdout(StringIO()):
            self._server.stop()

    @property
    def server(self) -> viser.ViserServer:
        """The page's server, for what others add to the page."""
        return self._server

    @property
    def url(self) -> str:
        """Address of the page, with the token without which all requests are refused."""
        host = self._server.get_host()
        shown = "localhost" if host in ("0.0.0.0", "::") else host  # noqa: S104
        bracketed = f"[{shown}]" if ":" in shown else shown
        return f"http://{bracketed}:{self._server.get_port()}/{self._guard.token}/"

    def add(self, view: PosedImages) -> None:
        """Show a view: camera and point cloud in the scene, images in the side panel."""
        with self._server.atomic():
            self.add_to_scene(view)
            self._show_images(view)

    def add_to_scene(self, view: PosedImages) -> None:
        """Show a view's camera and point cloud, without its images."""
        self._view_count += 1
        self._add_camera(view)
        self._show_cloud(view)
        self._describe(view)

    def set_mesh(self, mesh: ColoredMesh) -> None:
        """Replace the mesh that is shown."""
        if not len(mesh.triangles):
            return
        shown = decimate(mesh, MAX_TRIANGLES)
        self._mesh = self._server.scene.add_glb(
            "/mesh", unlit_glb(shown), visible=self._checkboxes["mesh"].value
        )

    def clear(self) -> None:
        """Remove all views and the mesh, as for a new world."""
        for handle in (*self._cameras, self._cloud):
            if handle is not None:
                handle.remove()
        self._cameras.clear()
        self._cloud = None
        self._view_count = 0
        self.clear_mesh()

    def clear_mesh(self) -> None:
        """Remove the mesh."""
        mesh, self._mesh = self._mesh, None
        if mesh is not None:
            mesh.remove()

    def save(self, path: Path) -> None:
        """Write the present scene as a page that needs neither a server nor a network."""
        write_whole_text(path, self._server.scene.as_html())

    def _add_camera(self, view: PosedImages) -> None:
        camera = view.camera.intrinsics
        T_map_camera = view.camera.T_map_camera
        handle = self._server.scene.add_camera_frustum(
            f"/cameras/{view.name}",
            fov=2 * float(np.arctan2(camera.height_px / 2, camera.fy_px)),
            aspect=camera.width_px * camera.fy_px / (camera.height_px * camera.fx_px),
            scale=FRUSTUM_M,
            color=(210, 105, 30),
            image=None if view.rgb is None else _thumbnail(view.rgb),
            wxyz=_quat_wxyz(T_map_camera),
            position=T_map_camera[:3, 3],
            visible=self._checkboxes["cameras"].value,
        )
        handle.on_click(lambda event: _look_from(event.client, T_map_camera))
        self._cameras.append(handle)
        while len(self._cameras) > MAX_CAMERAS:
            self._cameras.popleft().remove()

    def _show_cloud(self, view: PosedImages) -> None:
        if view.depth_m is None:
            return
        points_m, colors_rgb = point_cloud_of(view, self._max_range_m, MAX_POINTS)
        T_map_camera = view.camera.T_map_camera
        self._cloud = self._server.scene.add_point_cloud(
            "/cloud",
            points=points_m.astype(np.float32),
            colors=colors_rgb,
            point_size=0.04,
            wxyz=_quat_wxyz(T_map_camera),
            position=T_map_camera[:3, 3],
            visible=self._checkboxes["cloud"].value,
        )

    def _show_images(self, view: PosedImages) -> None:
        for name, image in side_pictures(view, self.labels).items():
            if name in self._images:
                self._images[name].image = image
            else:
                self._images[name] = self._server.gui.add_image(image, label=name, format="jpeg")

    def _describe(self, view: PosedImages) -> None:
        x_m, y_m, z_m = view.camera.T_map_camera[:3, 3]
        self._description.content = (
            f"**{self._view_count}** views; the newest, {escape_markdown(view.name)}, from "
            f"({x_m:.1f}, {y_m:.1f}, {z_m:.1f}) m. Click a camera to look from there."
        )

    def _update_visibility(self, _event: Any) -> None:
        chosen = {name: box.value for name, box in self._checkboxes.items()}
        for camera in self._cameras:
            camera.visible = chosen["cameras"]
        if self._mesh is not None:
            self._mesh.visible = chosen["mesh"]
        if self._cloud is not None:
            self._cloud.visible = chosen["cloud"]


def side_pictures(view: PosedImages, labels: Mapping[int, str]) -> dict[str, NDArray[np.uint8]]:
    """Return the images of a view as (H, W, 3) pictures by their names on the page."""
    images: dict[str, NDArray[np.uint8]] = {}
    if view.rgb is not None:
        images["colour"] = view.rgb
    if view.depth_m is not None:
        images["depth"] = pictures.depth_picture(view.depth_m, *_range_m(view.depth_m))
    if view.semantic_ids is not None:
        images["classes"] = pictures.semantic_picture(view.semantic_ids, labels)
    if view.instance_ids is not None:
        images["objects"] = pictures.instance_picture(view.instance_ids)
    return images


def point_cloud_of(
    view: PosedImages, max_range_m: float, max_points: int
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Return up to ``max_points`` (N, 3) points in the optical frame and their (N, 3) colours.

    Raises:
        ValueError: The view has no depth.
    """
    if view.depth_m is None:
        raise ValueError("a point cloud needs depth")
    stride = max(1, int(np.ceil(np.sqrt(view.depth_m.size / max_points))))
    part = (slice(None, None, stride),) * 2
    points_m = depth_to_points(view.depth_m, view.camera.intrinsics)[part].reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        kept = np.isfinite(points_m).all(axis=1) & (points_m[:, 2] <= max_range_m)
    if view.rgb is None or view.rgb.shape[:2] != view.depth_m.shape:
        colors_rgb = np.full((len(points_m), 3), 150, np.uint8)
    else:
        colors_rgb = view.rgb[part].reshape(-1, 3)
    return np.asarray(points_m[kept]), np.asarray(colors_rgb[kept])


def _range_m(depth_m: NDArray[np.float32]) -> tuple[float, float]:
    finite = depth_m[np.isfinite(depth_m)]
    if not len(finite):
        return 0.0, 1.0
    near_m, far_m = np.percentile(finite, (1, 99))
    return float(near_m), float(far_m)


def _thumbnail(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape[:2]
    size = (THUMBNAIL_WIDTH_PX, max(1, round(THUMBNAIL_WIDTH_PX * height / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _quat_wxyz(T_map_camera: FloatArray) -> FloatArray:
    x, y, z, w = pose_from_matrix(T_map_camera).quat_xyzw
    return np.array((w, x, y, z))


def _look_from(client: Any, T_map_camera: FloatArray) -> None:
    """Move the browser's camera to the pose of a camera."""
    send_camera(client, T_map_camera[:3, 3], T_map_camera[:3, 3] + 5.0 * T_map_camera[:3, 2])


def send_camera(client: Any, position_m: FloatArray, look_at_m: FloatArray) -> None:
    """Have a browser look from a (3,) point at another one.

    It stays where it is if it says at that very moment that it is where it is to look.
    """
    with client.atomic(), suppress(ValueError):
        client.camera.position = position_m
        client.camera.look_at = look_at_m
