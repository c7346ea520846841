"""The live page: what the driver's browser sends, and what all browsers show."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import viser
from numpy.typing import NDArray

from oaisys_core.files.markdown import escape_markdown
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.report.pictures import label_color
from oaisys_mapping.report.web_viewer import (
    PosedImages,
    WebViewer,
    send_camera,
    side_pictures,
)
from oaisys_ros_bridge.live.browser_values import aspect_of, pose_of
from oaisys_ros_bridge.live.desk import BrowserView, Desk, Request
from oaisys_ros_bridge.live.driver_panel import DriverPanel

PIVOT_M = 0.1
"""Distance of the point that the browser's camera turns around: it turns almost on the spot."""

ECHO_TOLERANCE_M = 1e-3
"""How far a browser is from where it was sent, by rounding."""

ASPECT_TOLERANCE = 0.01
"""By how much the shape of a window differs from that of its picture, as a share."""

NOTE_S = 8.0
"""How long a note stays on the page."""

MAX_BACKGROUND_PX = 1600
"""Width of the picture with its black bars."""

JPEG_QUALITY = 85

SIDE_PX = 220
"""Width of the images beside the window."""


class LivePage:
    """Shows pictures and map to everybody; one browser, the driver's, has the controls.

    The first browser drives. Others may take over with a button; if the driver's page is closed,
    nobody drives until one does.

    Args:
        viewer: The page with images and map.
        desk: Takes what the driver asks for.
        bag_fault: Why no bag can be recorded; empty: one can.
    """

    def __init__(self, viewer: WebViewer, desk: Desk, bag_fault: str) -> None:
        self._viewer = viewer
        self._desk = desk
        self._bag_fault = bag_fault
        self._lock = threading.RLock()
        self._driver: viser.ClientHandle | None = None
        self._panel: DriverPanel | None = None
        self._buttons: dict[int, Any] = {}
        self._pivot_m: FloatArray | None = None
        self._sent_from_m: FloatArray | None = None
        self._pose: FloatArray | None = None
        self._camera: PinholeIntrinsics | None = None
        self._picture: NDArray[np.uint8] | None = None
        self._drawn_aspect = 0.0
        self._is_recording = False
        self._status = viewer.server.gui.add_markdown("Starting.", order=-100)
        self._images: dict[str, Any] = {}
        self._side = _add_image_panel(viewer.server)
        with self._side:
            self._legend = viewer.server.gui.add_markdown("", order=1000)
        viewer.server.on_client_connect(self._welcome)
        viewer.server.on_client_disconnect(self._part)

    @property
    def speed_ratio(self) -> float:
        """How far the camera goes for each metre that the browser's goes."""
        with self._lock:
            return 1.0 if self._panel is None else self._panel.speed_ratio

    def say(self, text: str) -> None:
        """Show a text in the line at the top of the side panel."""
        self._status.content = escape_markdown(text)

    def note(self, title: str, text: str, *, is_error: bool = False) -> None:
        """Show a note to the driver, or to everybody where nobody drives."""
        with self._lock:
            driver = self._driver
        everybody = self._viewer.server.get_clients().values()
        for client in everybody if driver is None else (driver,):
            client.add_notification(
                title,
                text,
                auto_close_seconds=NOTE_S,
                color="red" if is_error else "green",
            )

    def _refuse(self, reason: str) -> None:
        self.note("Refused", reason, is_error=True)

    def show_labels(self, labels: Mapping[int, str]) -> None:
        """Show the names of classes in their colours."""
        self._viewer.labels = labels
        parts = []
        for semantic_id, name in sorted(labels.items()):
            red, green, blue = (int(each) for each in label_color(semantic_id, labels))
            block = f'<span style="color:rgb({red},{green},{blue})">&#9632;</span>'
            parts.append(f"{block} {escape_markdown(name)}")
        self._legend.content = "&ensp;".join(parts)

    def show_pose(self, T_map_camera: FloatArray) -> None:
        """Have the driver's browser look from a pose; its views count from there on."""
        with self._lock:
            self._pose = T_map_camera
            self._desk.forget_view()
            if self._driver is not None and self._shows_picture():
                self._send_to_pose(self._driver)

    def show_picture(self, view: PosedImages) -> None:
        """Show the images of a view; the driver's window shows its colour."""
        self._show_side_images(view)
        with self._lock:
            self._pose = view.camera.T_map_camera
            self._camera, self._picture = view.camera.intrinsics, view.rgb
            if self._driver is not None and self._shows_picture():
                self._draw_background(self._driver)

    def _show_side_images(self, view: PosedImages) -> None:
        gui = self._viewer.server.gui
        for name, image in side_pictures(view, self._viewer.labels).items():
            small = letterbox(image, image.shape[1] / image.shape[0], SIDE_PX)
            if name in self._images:
                self._images[name].image = small
            else:
                with self._side:
                    self._images[name] = gui.add_image(small, label=name, format="jpeg")

    def show_recording(self, *, is_on: bool) -> None:
        """Show whether a bag is being recorded."""
        with self._lock:
            self._is_recording = is_on
            if self._panel is not None:
                self._panel.show_recording(is_on=is_on)

    def _shows_picture(self) -> bool:
        return self._panel is not None and self._panel.window == "picture"

    def _welcome(self, client: viser.ClientHandle) -> None:
        client.camera.on_update(lambda camera: self._take_view(client, camera))
        with self._lock:
            if client.client_id not in self._viewer.server.get_clients():
                return  # it has gone meanwhile, and is not parted from again
            if self._driver is None and not self._buttons:
                self._make_driver(client)
            else:
                self._make_watcher(client)

    def _part(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._buttons.pop(client.client_id, None)
            if self._driver is not None and self._driver.client_id == client.client_id:
                if self._panel is not None:
                    self._panel.retire()
                self._driver = self._panel = None
                self._desk.forget_view()

    def _make_driver(self, client: viser.ClientHandle) -> None:
        # The new driver's panel begins with a flight.
        flight = Request("choose_vehicle", {"is_rover": False, "camera_height_m": 0.0})
        dropped = self._desk.begin_anew(flight)
        self._driver = client
        with client.atomic():  # it is shown once all of it reacts: an early click would be lost
            self._panel = DriverPanel(
                client, self._desk, self._change_window, self._refuse, self._bag_fault
            )
            self._panel.show_recording(is_on=self._is_recording)
            self._change_window()
        if dropped:
            them = "1 request" if dropped == 1 else f"{dropped} requests"
            self.note("New driver", f"{them} of the driver before you will not be done")

    def _make_watcher(self, client: viser.ClientHandle) -> None:
        client.scene.set_background_image(None)
        client.scene.set_global_visibility(True)
        with client.atomic():
            button = client.gui.add_button("Take the wheel", order=-50)
            self._buttons[client.client_id] = button
            button.on_click(lambda _: self._hand_over(client))

    def _hand_over(self, client: viser.ClientHandle) -> None:
        """Make a watcher the driver, and the driver a watcher."""
        with self._lock:
            button = self._buttons.pop(client.client_id, None)
            if button is None:
                return
            button.remove()
            before, panel = self._driver, self._panel
            if before is not None and panel is not None:
                panel.remove()
                self._make_watcher(before)
            self._make_driver(client)

    def _change_window(self) -> None:
        """Show the driver what was chosen: the picture, or the map with its own camera."""
        with self._lock:
            client = self._driver
            if client is None:
                return
            is_picture = self._shows_picture()
            client.scene.set_global_visibility(not is_picture)
            if is_picture:
                if self._pose is not None:
                    self._send_to_pose(client)
                self._draw_background(client)
            else:
                client.scene.set_background_image(None)
                self._overlook(client)

    def _overlook(self, client: viser.ClientHandle) -> None:
        """Look at the map from above and behind the camera."""
        if self._pose is None:
            return
        place_m, forward = self._pose[:3, 3], self._pose[:3, 2]
        above_m = place_m - 6.0 * forward + np.array((0.0, 0.0, 6.0))
        send_camera(client, above_m, place_m + 3.0 * forward)

    def _take_view(self, client: viser.ClientHandle, camera: viser.CameraHandle) -> None:
        """Post where the driver's browser looks."""
        with self._lock:
            is_driver = self._driver is not None and self._driver.client_id == client.client_id
            if not is_driver or not self._shows_picture() or self._pose is None:
                return
            # The side panels take their places after the first picture, and windows are resized.
            if not np.isclose(aspect_of(camera), self._drawn_aspect, rtol=ASPECT_TOLERANCE):
                self._draw_background(client)
            pose = pose_of(camera)
            if pose is None:
                return
            pivot_m = pose.look_at_m
            before_m = self._pivot_m
            if before_m is None or self._is_of_old_place(pivot_m, before_m):
                return
            step_m, self._pivot_m = pivot_m - before_m, pivot_m
            self._desk.post_view(BrowserView(step_m, pose.R_map_camera))

    def _is_of_old_place(self, pivot_m: FloatArray, sent_to_m: FloatArray) -> bool:
        """Return whether a view is from before the browser was sent to a place, or only says so."""
        sent_from_m = self._sent_from_m
        if sent_from_m is None:
            return False
        from_there_m = float(np.linalg.norm(pivot_m - sent_to_m))
        if from_there_m >= np.linalg.norm(pivot_m - sent_from_m):
            return True
        self._sent_from_m = None
        return from_there_m <= ECHO_TOLERANCE_M

    def _send_to_pose(self, client: viser.ClientHandle) -> None:
        assert self._pose is not None
        pivot_m, forward = self._pose[:3, 3].copy(), self._pose[:3, 2]
        at = pose_of(client.camera)
        is_there = at is None or np.linalg.norm(at.look_at_m - pivot_m) <= ECHO_TOLERANCE_M
        self._sent_from_m = None if at is None or is_there else at.look_at_m
        self._pivot_m = pivot_m
        send_camera(client, pivot_m - PIVOT_M * forward, pivot_m)

    def _draw_background(self, client: viser.ClientHandle) -> None:
        if self._picture is None or self._camera is None:
            return
        self._drawn_aspect = aspect_of(client.camera)
        canvas = letterbox(self._picture, self._drawn_aspect)
        client.scene.set_background_image(canvas, "jpeg", jpeg_quality=JPEG_QUALITY)


def _add_image_panel(server: viser.ViserServer) -> Any:
    """Return a tab for images at the left edge of the window."""
    panel = server.gui.add_panel()
    tab = panel.add_tab("Images")
    panel.dock_left()
    panel.set_width(SIDE_PX)
    return tab


def letterbox(
    rgb: NDArray[np.uint8], aspect: float, max_width_px: int = MAX_BACKGROUND_PX
) -> NDArray[np.uint8]:
    """Return an (H, W, 3) picture with black bars, so that W / H is about ``aspect``.

    It is made smaller where it is wider than ``max_width_px``.
    """
    height, width = rgb.shape[:2]
    wide, high = max(width, round(height * aspect)), max(height, round(width / aspect))
    canvas = np.zeros((high, wide, 3), np.uint8)
    top, left = (high - height) // 2, (wide - width) // 2
    canvas[top : top + height, left : left + width] = rgb
    if wide > max_width_px:
        size = (max_width_px, max(1, round(high * max_width_px / wide)))
        canvas = np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_AREA), np.uint8)
    return canvas
