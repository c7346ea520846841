"""Shapes of URDF's and SDF's ``<visual>``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.robots.elements import XmlElement
from oaisys_core.files.calibrations.robots.records import Notes, Shape

Rgba = tuple[float, float, float, float]

GREY = (0.5, 0.5, 0.5)
HIDDEN = 0.01
"""Opacity up to which nothing is shown, as of bodies that are there for collisions alone."""


@contextmanager
def tolerate(notes: Notes) -> Iterator[None]:
    """Note a visual that is wrong instead of refusing the robot and its sensors."""
    try:
        yield
    except InvalidInputError as error:
        notes.add(f"not shown: {error}")


def sdf_shape(visual: XmlElement, notes: Notes) -> Shape | None:
    """Return the shape of a visual of SDF; None, and a note, if we have none such.

    Raises:
        InvalidInputError: A number is missing or wrong.
    """
    geometry = visual.child("geometry")
    for element in [] if geometry is None else geometry.children:
        match element.tag:
            case "box":
                return _positive(element, Shape("box", tuple(element.require("size").numbers(3))))
            case "cylinder" | "capsule":
                lengths = (element.number("radius"), element.number("length"))
                return _positive(element, Shape(_round(element.tag), lengths))
            case "sphere":
                return _positive(element, Shape("sphere", (element.number("radius"),)))
            case "ellipsoid":
                radii = tuple(element.require("radii").numbers(3))
                return _positive(element, Shape("ellipsoid", radii))
            case "mesh":
                return _sdf_mesh(element, notes)
    kind = geometry.children[0].tag if geometry is not None and geometry.children else "nothing"
    notes.add(f"not shown: {visual.attributes.get('name', 'a visual')}, whose shape is {kind}")
    return None


def _sdf_mesh(mesh: XmlElement, notes: Notes) -> Shape | None:
    scale = mesh.child("scale")
    factors = (1.0, 1.0, 1.0) if scale is None else tuple(scale.numbers(3))
    submesh = mesh.child("submesh")
    name = None
    if submesh is not None:
        name = submesh.require("name").text
        if submesh.value("center", "false") in ("true", "1"):
            notes.add(f"not shown: the submesh {name}, which is centred")
            return None
    return _scaled(mesh, Shape("mesh", factors, mesh.require("uri").text, name))


def sdf_color(visual: XmlElement) -> Rgba | None:
    """Return the diffuse colour of a visual of SDF with its transparency; None without both."""
    material = visual.child("material")
    diffuse = None if material is None else material.child("diffuse")
    opacity = 1 - visual.number("transparency", 0.0)
    if diffuse is None or not diffuse.text:
        return None if opacity == 1 else (*GREY, opacity)
    *rgb, alpha = _rgba(diffuse, diffuse.text)
    return (rgb[0], rgb[1], rgb[2], alpha * opacity)


def is_shown(name: str, color: Rgba | None, notes: Notes) -> bool:
    """Return whether a visual is opaque enough to be shown; what is not so in the file is noted."""
    opacity = 1.0 if color is None else color[3]
    if opacity <= HIDDEN:
        notes.add(f"not shown: {name}, which is transparent")
    elif opacity < 1:
        notes.add(f"{name} is see-through in the file, and opaque here")
    return opacity > HIDDEN


def urdf_shape(visual: XmlElement) -> Shape:
    """Return the shape of a visual of URDF.

    Raises:
        InvalidInputError: A number is missing or wrong, or there is no such shape.
    """
    geometry = visual.require("geometry")
    for element in geometry.children:
        match element.tag:
            case "box":
                size = element.numbers(3, text=element.attribute("size"))
                return _positive(element, Shape("box", tuple(size)))
            case "cylinder" | "capsule":
                lengths = (_number(element, "radius"), _number(element, "length"))
                return _positive(element, Shape(_round(element.tag), lengths))
            case "sphere":
                return _positive(element, Shape("sphere", (_number(element, "radius"),)))
            case "mesh":
                scale = element.numbers(3, text=element.attributes.get("scale", "1 1 1"))
                shape = Shape("mesh", tuple(scale), element.attribute("filename"))
                return _scaled(element, shape)
    shown = geometry.children[0].tag if geometry.children else "nothing"
    raise InvalidInputError(geometry.where, shown, "box, cylinder, capsule, sphere or mesh")


def urdf_color(visual: XmlElement, known: dict[str, Rgba], notes: Notes) -> Rgba | None:
    """Return the colour of a visual of URDF, its own or that of a material by name.

    Args:
        visual: It.
        known: Colours by material.
        notes: Where a texture, and a material that is nowhere, is noted.
    """
    material = visual.child("material")
    if material is None:
        return None
    name = material.attributes.get("name", "")
    color = material_color(material, notes)
    if color is None and name not in known and material.child("texture") is None:
        notes.add(f"the material {name!r} has no colour anywhere")
    return known.get(name) if color is None else color


def material_color(material: XmlElement, notes: Notes) -> Rgba | None:
    """Return the colour of a material of URDF; None without one."""
    texture = material.child("texture")
    if texture is not None:
        shown = texture.attributes.get("filename", "?")
        notes.add(f"not used: the texture {shown} of a material; textures of meshes are")
    color = material.child("color")
    return None if color is None else _rgba(color, color.attribute("rgba"))


def _rgba(element: XmlElement, text: str) -> Rgba:
    """Return a colour, clamped to 0 to 1 as Gazebo and RViz do."""
    values = element.numbers(len(text.split()), text=text)
    if len(values) not in (3, 4):
        raise InvalidInputError(element.where, text, "red, green, blue and alpha from 0 to 1")
    red, green, blue, alpha = (min(max(value, 0.0), 1.0) for value in (*values, 1.0)[:4])
    return (red, green, blue, alpha)


def _round(tag: str) -> Literal["cylinder", "capsule"]:
    return "cylinder" if tag == "cylinder" else "capsule"


def _number(element: XmlElement, key: str) -> float:
    return element.numbers(1, text=element.attribute(key))[0]


def _positive(element: XmlElement, shape: Shape) -> Shape:
    if min(shape.size_m) <= 0:
        raise InvalidInputError(element.where, list(shape.size_m), "sizes above 0")
    return shape


def _scaled(element: XmlElement, shape: Shape) -> Shape:
    if not all(shape.size_m):
        raise InvalidInputError(element.where, list(shape.size_m), "factors that are not 0")
    return shape
