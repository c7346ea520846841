"""SDF's ``<sensor>``, which URDF has inside of ``<gazebo>``."""

from __future__ import annotations

from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.records import (
    CalibratedCamera,
    Calibration,
    frame_name,
    mount,
)
from oaisys_core.files.calibrations.robots import lidars
from oaisys_core.files.calibrations.robots.cameras import (
    MODALITIES,
    read_camera,
    read_depth_range_m,
)
from oaisys_core.files.calibrations.robots.elements import XmlElement
from oaisys_core.files.calibrations.robots.frames import pose_in
from oaisys_core.files.calibrations.robots.imus import read_imu
from oaisys_core.files.calibrations.robots.records import Notes
from oaisys_core.types import FloatArray

OPTICAL = "optical"
MOST_SENSORS = 1000
NAMES = (
    *("topic", "gz_frame_id", "ignition_frame_id", "frame_id", "optical_frame_id"),
    *("camera_info_topic", "trigger_topic", "always_on", "visualize", "enable_metrics"),
)
"""Elements that change nothing of what is measured."""


def is_known(sensor: XmlElement) -> bool:
    """Return whether a sensor is of a kind that we have."""
    return sensor.attributes.get("type") in (*MODALITIES, *lidars.KINDS, "imu")


class SensorCollection:
    """The sensors of a robot, in the order of the file."""

    def __init__(self, notes: Notes) -> None:
        self._notes = notes
        self._cameras: list[CalibratedCamera] = []
        self._lidars: list[dict[str, Any]] = []
        self._imus: list[dict[str, Any]] = []
        self._depth_ranges_m: dict[str, tuple[float, float] | None] = {}
        self._plugins: dict[str, None] = {}
        self.links: dict[str, str] = {}
        """By the name of a sensor the link that it is on."""

    def add(self, sensor: XmlElement, T_base_sensor: FloatArray, link: str) -> None:
        """Add a sensor, or note that we have none of its kind.

        Raises:
            InvalidInputError: A value is missing or wrong, or we lack its model.
        """
        kind = sensor.attribute("type")
        if len(self.links) >= MOST_SENSORS:
            raise InvalidInputError(sensor.where, "more sensors", f"at most {MOST_SENSORS}")
        self.note_plugins(sensor)
        if kind in MODALITIES:
            self._add_cameras(sensor, kind, T_base_sensor, link)
        elif kind in lidars.KINDS:
            name = self._name(sensor.attributes.get("name"), "lidar", link)
            found = lidars.read_lidar(sensor, name, self._rate_hz(sensor, name), self._notes)
            self._lidars.append(found | mount(T_base_sensor))
            self._note_unused(sensor, name)
        elif kind == "imu":
            name = self._name(sensor.attributes.get("name"), "imu", link)
            found = read_imu(sensor, name, self._rate_hz(sensor, name), self._notes)
            self._imus.append(found | mount(T_base_sensor))
            self._note_unused(sensor, name)
        else:
            shown = sensor.attributes.get("name", "")
            self._notes.add(f"not used: the {kind} {shown!r} on {link}: no such sensor here")

    def note_plugins(self, element: XmlElement) -> None:
        """Note that the plugins in an element are not used."""
        for plugin in element.all("plugin"):
            plugin.mark_read()
            self._plugins.setdefault(plugin.attributes.get("filename", "?"))

    def calibration(self, format_name: str) -> Calibration:
        """Return all of them, with the notes."""
        faults = self._depth_faults()
        if self._plugins:
            self._notes.add(f"not used: Gazebo's plugins {', '.join(self._plugins)}")
        return Calibration(
            format_name,
            tuple(self._cameras),
            tuple(self._imus),
            tuple(self._notes.lines),
            tuple(self._lidars),
            faults,
        )

    def _add_cameras(
        self, sensor: XmlElement, kind: str, T_base_sensor: FloatArray, link: str
    ) -> None:
        cameras = sensor.all("camera")
        if not cameras or (len(cameras) > 1 and kind != "multicamera"):
            raise InvalidInputError(sensor.where, f"{len(cameras)} <camera>", "one <camera>")
        for camera in cameras:
            text = sensor.attributes.get("name", "")
            if kind == "multicamera":
                text = f"{text}_{camera.attributes.get('name', '')}"
            name = self._name(text, "camera", link)
            T = T_base_sensor @ pose_in(camera)
            rate_hz = self._rate_hz(sensor, name)
            found = read_camera(camera, name, kind, T, rate_hz, self._notes)
            if "depth" in found.modalities:
                self._depth_ranges_m[name] = read_depth_range_m(camera)
            self._cameras.append(found)
            self._note_unused(camera, name)
            if OPTICAL in link.lower():
                self._notes.add(
                    f"{name}: Gazebo's cameras look along x of their link, and so does this one;"
                    f" if {link} is an optical frame (z forward), that is to its right"
                )
        self._note_unused(sensor, sensor.attributes.get("name", kind))

    def _name(self, text: str | None, default: str, link: str) -> str:
        """Return a name that no other sensor has."""
        plain = frame_name((text or default).split("::")[-1], default)
        name, number = plain, 2
        while name in self.links:
            name, number = f"{plain[:60]}_{number}", number + 1
        if name != plain:
            self._notes.add(f"{name} is the sensor {text!r} on {link}")
        self.links[name] = link
        return name

    def _rate_hz(self, sensor: XmlElement, name: str) -> float | None:
        rate_hz = sensor.number("update_rate", 0.0)
        if rate_hz < 0:
            raise InvalidInputError(sensor.where, f"update_rate {rate_hz:g}", "a number above 0")
        if not rate_hz:
            self._notes.add(f"{name}: no update_rate, so that its rate_hz is our default")
        return rate_hz or None

    def _note_unused(self, element: XmlElement, name: str) -> None:
        element.all(*NAMES)
        if unused := list(dict.fromkeys(element.unread())):
            self._notes.add(f"not used of {name}: {', '.join(unused)}")
        element.mark_read()

    def _depth_faults(self) -> dict[str, float]:
        """Return the depths that all depth cameras measure, if they agree."""
        found = set(self._depth_ranges_m.values())
        if len(found) == 1 and (bounds := next(iter(found))) is not None:
            return {"min_depth_m": bounds[0], "max_depth_m": bounds[1]}
        for name, bounds in self._depth_ranges_m.items():
            if bounds is not None:
                shown = f"{bounds[0]:g} to {bounds[1]:g} m"
                self._notes.add(
                    f"{name}: its clip of {shown} is not used: sensors.faults.min_depth_m and"
                    " max_depth_m are those of all depth images"
                )
        return {}
