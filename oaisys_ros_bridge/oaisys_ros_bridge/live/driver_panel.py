"""The fields and buttons of the one who drives, in the side panel of that browser alone."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Literal

import numpy as np
import viser

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import ModuleMetadata
from oaisys_ros_bridge.live.browser_values import number_of, text_of
from oaisys_ros_bridge.live.desk import MAX_REQUESTS, Action, Desk, Request

Window = Literal["picture", "map"]

SPEED, HEIGHT = "speed, m/s", "camera height, m"
FLY, DRIVE = "fly", "drive the rover"

BROWSER_SPEED_M_S = 2.0
"""How fast viser moves the browser's camera while a key is down."""

_PLACE = (48.0, 11.0)
"""Latitude and longitude at first, degrees."""


class DriverPanel:
    """Turns what the driver clicks into requests.

    Args:
        client: The driver's browser.
        desk: Takes the requests.
        on_window: Called when the driver has chosen what the window shows.
        on_refusal: Called with what is wrong with a field.
        bag_fault: Why no bag can be recorded; empty: one can.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        desk: Desk,
        on_window: Callable[[], None],
        on_refusal: Callable[[str], None],
        bag_fault: str,
    ) -> None:
        self._gui = client.gui
        self._desk = desk
        self._on_refusal, self._bag_fault = on_refusal, bag_fault
        self._folders: list[Any] = []
        self._is_retired = False
        # Reactions run on many threads: what one has read must not be posted after a newer value.
        self._reacting = threading.Lock()
        with self._folder("Drive", -40):
            self._add_motion(on_window)
        with self._folder("World", -30):
            self._add_world()
        with self._folder("Light", -20, is_open=False):
            self._add_light()
        with self._folder("Keep", -10):
            self._add_outputs()

    @property
    def window(self) -> Window:
        """What the window shows: the camera's picture, or the map."""
        return "map" if self._window.value == "map" else "picture"

    @property
    def speed_ratio(self) -> float:
        """How far the camera goes for each metre that the browser's goes."""
        low, high = self._speed.min, self._speed.max
        speed_m_s = float(self._speed.value)
        return float(np.clip(speed_m_s, low, high) if speed_m_s > 0 else low) / BROWSER_SPEED_M_S

    def retire(self) -> None:
        """Ask for nothing more: clicks of a driver who is none any more may wait for a thread."""
        self._is_retired = True

    def remove(self) -> None:
        """Take the panel off the page."""
        self.retire()
        for folder in self._folders:
            folder.remove()

    def show_recording(self, *, is_on: bool) -> None:
        """Show whether a bag is being recorded."""
        self._record.disabled = is_on or bool(self._bag_fault)
        self._stop.disabled = not is_on

    def _folder(
        self, name: str, order: float, *, is_open: bool = True
    ) -> AbstractContextManager[Any]:
        folder = self._gui.add_folder(name, order=order, expand_by_default=is_open)
        self._folders.append(folder)
        return folder

    def _add_motion(self, on_window: Callable[[], None]) -> None:
        gui = self._gui
        self._window = gui.add_dropdown("window shows", ("picture", "map"), initial_value="picture")
        self._window.on_update(lambda _: on_window())
        vehicle = gui.add_dropdown("vehicle", (FLY, DRIVE), initial_value=FLY)
        self._speed = gui.add_slider(SPEED, min=0.5, max=40.0, step=0.5, initial_value=6.0)
        height = gui.add_slider(HEIGHT, min=0.2, max=5.0, step=0.1, initial_value=1.5)

        def choose(_event: Any) -> None:
            is_rover = vehicle.value == DRIVE
            self._post("choose_vehicle", is_rover=is_rover, camera_height_m=number_of(height))

        vehicle.on_update(self._checked(choose))
        height.on_update(self._checked(choose))
        gui.add_markdown(
            "Click the picture, then **W A S D** to move, **E Q** up and down, arrow keys or "
            "dragging to turn."
        )

    def _add_world(self) -> None:
        gui = self._gui
        number = gui.add_number("seed", 1, min=0, max=2**53, step=1)
        preset = gui.add_text("preset", "", hint="Kind of terrain; empty: as configured.")
        button = gui.add_button("New world")

        def build(_event: Any) -> None:
            self._post("new_world", seed=int(number_of(number)), preset=text_of(preset))

        button.on_click(self._checked(build))

    def _add_light(self) -> None:
        gui = self._gui
        elevation = gui.add_slider("sun height, deg", min=-10, max=90, step=0.5, initial_value=38)
        azimuth = gui.add_slider(
            "sun azimuth, deg",
            min=0,
            max=360,
            step=1,
            initial_value=125,
            hint="From +x (east) towards +y (north).",
        )
        time = gui.add_text("time", "", hint="With UTC offset: 2026-06-21T12:00:00+02:00")
        latitude = gui.add_number("latitude, deg", _PLACE[0], min=-90, max=90, step=0.1)
        longitude = gui.add_number("longitude, deg", _PLACE[1], min=-180, max=180, step=0.1)
        haze = gui.add_slider("visibility, km", min=0.1, max=50, step=0.1, initial_value=50)
        exposure = gui.add_slider("exposure, stops", min=-6, max=8, step=0.1, initial_value=0)
        is_automatic = gui.add_checkbox("automatic exposure", initial_value=True)

        def move_sun(_event: Any) -> None:
            self._change_environment(
                sun_from_time=None,
                sun_elevation_deg=number_of(elevation),
                sun_azimuth_deg=number_of(azimuth),
            )

        def set_time(_event: Any) -> None:
            place = {"latitude_deg": number_of(latitude), "longitude_deg": number_of(longitude)}
            given = {"date_time": text_of(time), **place}
            self._change_environment(sun_from_time=given)

        def set_haze(_event: Any) -> None:
            visibility_km = number_of(haze)
            air = None if visibility_km >= haze.max else {"visibility_m": 1000.0 * visibility_km}
            self._change_environment(haze=air)

        def expose(_event: Any) -> None:
            stops = None if is_automatic.value else number_of(exposure)
            self._change(ModuleMetadata(render={"exposure_ev": stops}))

        for field, react in (
            (elevation, move_sun),
            (azimuth, move_sun),
            (haze, set_haze),
            (exposure, expose),
            (is_automatic, expose),
        ):
            field.on_update(self._checked(react))
        by_time = gui.add_button(
            "Sun by time and place", hint="Until a slider of the sun is moved."
        )
        by_time.on_click(self._checked(set_time))

    def _add_outputs(self) -> None:
        gui = self._gui
        actions: dict[str, Action] = {
            "Take a picture": "take_picture",
            "Keep the pose for a survey": "keep_pose",
            "Export the configuration": "export_config",
        }
        for label, action in actions.items():
            gui.add_button(label).on_click(partial(self._press, action))
        hint = self._bag_fault or "rosbag2, MCAP"
        self._record = gui.add_button("Record a bag", hint=hint, disabled=bool(self._bag_fault))
        self._stop = gui.add_button("End the bag", disabled=True)
        self._record.on_click(partial(self._press, "start_bag"))
        self._stop.on_click(partial(self._press, "stop_bag"))

    def _checked(self, react: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a reaction to a field that tells the driver where the field cannot be used."""

        def checked(event: Any) -> None:
            try:
                with self._reacting:
                    react(event)
            except InvalidInputError as error:
                self._on_refusal(str(error))

        return checked

    def _press(self, action: Action, _event: Any) -> None:
        self._post(action)

    def _post(self, action: Action, **values: Any) -> None:
        if not self._is_retired and not self._desk.post(Request(action, values)):
            self._on_refusal(f"{MAX_REQUESTS} requests wait already; this one is dropped")

    def _change_environment(self, **values: Any) -> None:
        self._change(ModuleMetadata(environment=values))

    def _change(self, change: ModuleMetadata) -> None:
        if not self._is_retired:
            self._desk.post_change(change)
