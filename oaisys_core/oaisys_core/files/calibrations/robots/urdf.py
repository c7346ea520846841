"""Robots in URDF, with Gazebo's sensors in ``<gazebo reference="LINK">``."""

from __future__ import annotations

import numpy as np

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.files.calibrations.robots.elements import FIELD, XmlElement
from oaisys_core.files.calibrations.robots.frames import origin_in, pose_of
from oaisys_core.files.calibrations.robots.records import (
    Joint,
    Notes,
    Robot,
    Visual,
    links_like_sensors,
    note_joints,
)
from oaisys_core.files.calibrations.robots.sensors import SensorCollection, is_known
from oaisys_core.files.calibrations.robots.visuals import (
    Rgba,
    is_shown,
    material_color,
    tolerate,
    urdf_color,
    urdf_shape,
)
from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray

BASE = "base_link"
KNOWN = {
    "robot": ("link", "joint", "material", "gazebo", "sensor", "transmission"),
    "link": ("visual", "collision", "inertial"),
    "joint": (
        *("origin", "parent", "child", "axis", "calibration", "dynamics", "limit", "mimic"),
        "safety_controller",
    ),
    "visual": ("origin", "geometry", "material"),
}
"""Elements of URDF in an element, of which those of shape and motion are not read."""


def read_urdf(root: XmlElement, base: str | None) -> Robot:
    """Return the robot of a URDF file, its joints at zero.

    Args:
        root: The file's root.
        base: Link that becomes ``base_link``; None: the link of this name, or the root.

    Raises:
        InvalidInputError: A value is missing or wrong, links and joints are no tree, or we lack a
            model of a sensor.
    """
    links = _links(root)
    joints = [
        (joint, Joint(joint.name, joint.attribute("type"), *_ends(joint, links)))
        for joint in root.all("joint")
    ]
    poses, root_link = _poses(links, joints)
    chosen = base or (BASE if BASE in links else root_link)
    if chosen not in poses:
        raise InvalidInputError(f"{FIELD}.base", chosen, one_of(list(poses), chosen))
    T_base_root = invert(poses[chosen])
    in_base = {name: T_base_root @ T for name, T in poses.items()}
    tree = [joint for _, joint in joints]
    notes = Notes()
    notes.add(f"the rig's base_link is the file's link {chosen}")
    _note_unknown([root, *links.values(), *(joint for joint, _ in joints)], notes)
    sensors = _sensors(root, in_base, notes)
    visual_notes = Notes()
    _note_unknown([v for link in links.values() for v in link.all("visual")], visual_notes)
    visuals = _visuals(root, links, in_base, visual_notes)
    note_joints(tree, sensors.links, notes, visual_notes)
    return Robot(
        root.attributes.get("name", "robot"),
        sensors.calibration("URDF"),
        tuple(visuals),
        tuple(visual_notes.lines),
        links_like_sensors(list(links)),
        in_base,
    )


def _note_unknown(elements: list[XmlElement], notes: Notes) -> None:
    """Note which elements in some of `KNOWN` URDF does not have there, perhaps misspelt."""
    for element in elements:
        unknown = [each.tag for each in element.children if each.tag not in KNOWN[element.tag]]
        if unknown:
            tags = ", ".join(dict.fromkeys(unknown))
            notes.add(f"not used of {element.tag} on line {element.line}: {tags}")


def _links(root: XmlElement) -> dict[str, XmlElement]:
    found: dict[str, XmlElement] = {}
    for link in root.all("link"):
        if link.name in found:
            lines = f"{link.name}, on lines {found[link.name].line} and {link.line}"
            raise InvalidInputError(link.where, lines, "links of different names")
        found[link.name] = link
    if not found:
        raise InvalidInputError(FIELD, "no <link>", "a robot with links")
    return found


def _ends(joint: XmlElement, links: dict[str, XmlElement]) -> tuple[str, str]:
    """Return the parent and the child of a joint."""
    ends = []
    for tag in ("parent", "child"):
        element = joint.require(tag)
        if (name := element.attribute("link")) not in links:
            raise InvalidInputError(element.where, name, one_of(list(links), name))
        ends.append(name)
    return ends[0], ends[1]


def _poses(
    links: dict[str, XmlElement], joints: list[tuple[XmlElement, Joint]]
) -> tuple[dict[str, FloatArray], str]:
    """Return the pose of each link in the root, the joints at zero, and the root."""
    below: dict[str, list[tuple[XmlElement, Joint]]] = {}
    children: set[str] = set()
    for element, joint in joints:
        if joint.child in children:
            raise InvalidInputError(element.where, f"{joint.child}, a child again", "a tree")
        children.add(joint.child)
        below.setdefault(joint.parent, []).append((element, joint))
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        shown = ", ".join(roots) or "a circle of joints"
        raise InvalidInputError(FIELD, shown[:200], "one link that is the child of no joint")
    found = {roots[0]: np.eye(4)}
    waiting = [roots[0]]
    while waiting:
        parent = waiting.pop()
        for element, joint in below.get(parent, []):
            found[joint.child] = found[parent] @ origin_in(element)
            waiting.append(joint.child)
    if missing := [name for name in links if name not in found]:
        raise InvalidInputError(FIELD, f"a circle of joints with {missing[0]}", "a tree of links")
    return found, roots[0]


def _sensors(root: XmlElement, in_base: dict[str, FloatArray], notes: Notes) -> SensorCollection:
    found = SensorCollection(notes)
    for gazebo in root.all("gazebo"):
        found.note_plugins(gazebo)
        for sensor in gazebo.all("sensor"):
            link = gazebo.attributes.get("reference", "")
            if link not in in_base and is_known(sensor):
                raise InvalidInputError(
                    gazebo.where, f"reference {link!r}", one_of(list(in_base), link)
                )
            T_base_link = in_base.get(link, np.eye(4))
            found.add(sensor, T_base_link @ _pose(sensor, link, in_base), link)
    for sensor in root.all("sensor"):
        name = sensor.attributes.get("name", "")
        notes.add(f"not used: URDF's own <sensor> {name!r}; those inside of <gazebo> are read")
    return found


def _pose(sensor: XmlElement, link: str, in_base: dict[str, FloatArray]) -> FloatArray:
    """Return the pose of a sensor on its link."""
    pose = sensor.child("pose")
    name = pose.attributes.get("relative_to") if pose is not None else None
    if not name:
        return pose_of(pose)
    if name not in in_base:
        raise InvalidInputError(sensor.where, name, one_of(list(in_base), name))
    return invert(in_base[link]) @ in_base[name] @ pose_of(pose)


def _visuals(
    root: XmlElement,
    links: dict[str, XmlElement],
    in_base: dict[str, FloatArray],
    notes: Notes,
) -> list[Visual]:
    """Return the visuals, in the order of the links."""
    known = _materials([root, *(v for link in links.values() for v in link.all("visual"))], notes)
    found = []
    for name, link in links.items():
        for visual in link.all("visual"):
            with tolerate(notes):
                T, color = in_base[name] @ origin_in(visual), urdf_color(visual, known, notes)
                shape = urdf_shape(visual)
                if is_shown(f"a visual of {name}", color, notes):
                    plain = None if color is None else color[:3]
                    found.append(Visual(visual.where, shape, T, plain))
    return found


def _materials(places: list[XmlElement], notes: Notes) -> dict[str, Rgba]:
    """Return the colours by name of all materials in the elements; the first of a name counts."""
    found: dict[str, Rgba] = {}
    for place in places:
        for material in place.all("material"):
            with tolerate(notes):
                if (color := material_color(material, notes)) is not None:
                    found.setdefault(material.attributes.get("name", ""), color)
    return found
