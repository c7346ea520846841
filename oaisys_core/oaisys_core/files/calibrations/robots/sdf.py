"""Models in SDF, with the frames of SDF 1.7 on: http://sdformat.org/tutorials?tut=pose_frame_semantics."""

from __future__ import annotations

from dataclasses import dataclass, field

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.files.calibrations.robots.elements import FIELD, XmlElement
from oaisys_core.files.calibrations.robots.frames import MODEL, FrameGraph, pose_of
from oaisys_core.files.calibrations.robots.records import (
    Joint,
    Notes,
    Robot,
    Visual,
    links_like_sensors,
    note_joints,
)
from oaisys_core.files.calibrations.robots.sensors import SensorCollection
from oaisys_core.files.calibrations.robots.visuals import is_shown, sdf_color, sdf_shape, tolerate
from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray

BASE = "base_link"
WRITE_IN = "`gz sdf -p FILE` writes the models that a file includes into it"


@dataclass
class ModelContent:
    """A model with the models nested in it, whose names begin with theirs and ``::``."""

    frames: FrameGraph = field(default_factory=FrameGraph)
    links: dict[str, tuple[XmlElement, str]] = field(default_factory=dict)
    """By name, with the prefix of its model."""
    joints: list[Joint] = field(default_factory=list)


def read_sdf(root: XmlElement, base: str | None, model_name: str | None) -> Robot:
    """Return the robot of an SDF file.

    Args:
        root: The file's root.
        base: Link or frame that becomes ``base_link``; None: the link of this name, or the model's
            frame.
        model_name: Which of the models; None for the only one.

    Raises:
        InvalidInputError: A value is missing or wrong, there are several models, something is
            included, or we lack a model of a sensor.
    """
    model = _choose(root, model_name)
    content = _read_model(model)
    chosen = base or (BASE if BASE in content.links else MODEL)
    T_base_model = invert(content.frames.pose(chosen, f"{FIELD}.base"))
    notes = Notes()
    base_name = "the model's frame" if chosen == MODEL else f"the file's {chosen}"
    notes.add(f"the rig's base_link is {base_name}")
    sensors = SensorCollection(notes)
    _note_model(model, sensors, notes)
    visuals: list[Visual] = []
    visual_notes = Notes()
    for name, (link, prefix) in content.links.items():
        for sensor in link.all("sensor"):
            T = T_base_model @ _pose_on(sensor, name, prefix, content)
            sensors.add(sensor, T, name)
        for visual in link.all("visual"):
            with tolerate(visual_notes):
                T = T_base_model @ _pose_on(visual, name, prefix, content)
                visuals += _visual(visual, T, visual_notes)
    note_joints(content.joints, sensors.links, notes, visual_notes)
    return Robot(
        model.name,
        sensors.calibration("SDF"),
        tuple(visuals),
        tuple(visual_notes.lines),
        links_like_sensors(list(content.links)),
        {name: T_base_model @ content.frames.pose(name, FIELD) for name in content.links},
    )


def _choose(root: XmlElement, name: str | None) -> XmlElement:
    scopes = [root, *root.all("world")]
    models = [model for scope in scopes for model in scope.all("model")]
    included = [each for scope in scopes for each in scope.all("include")]
    names = [model.name for model in models]
    if not models:
        uris = ", ".join(each.value("uri") or "?" for each in included)
        shown = f"<include> of {uris}" if included else "no <model>"
        raise InvalidInputError(FIELD, shown, f"a file with a model; {WRITE_IN}")
    if name is None and len(models) == 1:
        return models[0]
    if name not in names:
        expected = one_of(names, name or "")
        raise InvalidInputError(f"{FIELD}.model", name, f"{expected} (--model NAME)")
    return models[names.index(name)]


def _read_model(model: XmlElement) -> ModelContent:
    """Return the frames, links and joints of a model in its own frame."""
    for include in model.all("include"):
        shown = f"<include> of {include.value('uri')}"
        raise InvalidInputError(include.where, shown, f"a model without includes; {WRITE_IN}")
    found = ModelContent()
    for link in model.all("link"):
        _add_frame(found.frames, link, MODEL)
        found.links[link.name] = (link, "")
    for joint in model.all("joint"):
        child, parent = joint.require("child").text, joint.require("parent").text
        if joint.name not in found.links:  # before SDF 1.7 both may have one name
            _add_frame(found.frames, joint, MODEL if child == "world" else child)
        found.joints.append(Joint(joint.name, joint.attribute("type"), parent, child))
    for frame in model.all("frame"):
        _add_frame(found.frames, frame, frame.attributes.get("attached_to") or MODEL)
    for nested in model.all("model"):
        _add_nested(found, nested)
    return found


def _add_frame(frames: FrameGraph, element: XmlElement, default: str) -> None:
    pose = element.child("pose")
    relative_to = pose.attributes.get("relative_to") if pose is not None else None
    frames.add(element.name, relative_to or default, pose_of(pose), element.where)


def _add_nested(found: ModelContent, nested: XmlElement) -> None:
    """Add a model that is in another one, placed by its own frame or its placement frame."""
    inner = _read_model(nested)
    pose = nested.child("pose")
    relative_to = pose.attributes.get("relative_to") if pose is not None else None
    placement = nested.attributes.get("placement_frame") or MODEL
    T = pose_of(pose) @ invert(inner.frames.pose(placement, nested.where))
    found.frames.add(nested.name, relative_to or MODEL, T, nested.where)
    prefix = f"{nested.name}::"
    for name, T_model_frame in inner.frames.poses():
        found.frames.add(prefix + name, nested.name, T_model_frame, nested.where)
    for name, (link, scope) in inner.links.items():
        found.links[prefix + name] = (link, prefix + scope)
    found.joints += [
        Joint(prefix + each.name, each.kind, prefix + each.parent, prefix + each.child)
        for each in inner.joints
    ]


def _pose_on(element: XmlElement, link: str, prefix: str, content: ModelContent) -> FloatArray:
    """Return the pose in the model of what is on a link, or relative to another frame."""
    pose = element.child("pose")
    relative_to = pose.attributes.get("relative_to") if pose is not None else None
    if relative_to == MODEL:
        frame = prefix.removesuffix("::") or MODEL
    else:
        frame = prefix + relative_to if relative_to else link
    return content.frames.pose(frame, element.where) @ pose_of(pose)


def _visual(visual: XmlElement, T: FloatArray, notes: Notes) -> list[Visual]:
    shape, color = sdf_shape(visual, notes), sdf_color(visual)
    name = visual.attributes.get("name", visual.where)
    if shape is None or not is_shown(name, color, notes):
        return []
    return [Visual(visual.where, shape, T, None if color is None else color[:3])]


def _note_model(model: XmlElement, sensors: SensorCollection, notes: Notes) -> None:
    """Note what of a model is neither a sensor nor a shape."""
    sensors.note_plugins(model)
    for joint in model.all("joint"):
        for sensor in joint.all("sensor"):
            kind = sensor.attributes.get("type")
            notes.add(f"not used: the {kind} sensor on the joint {joint.name}")
    for link in model.all("link"):
        for light in link.all("light"):
            shown = light.attributes.get("name", "")
            notes.add(f"not used: the light {shown!r}; environment.lamps may be on base_link")
