"""Base colours and cut-outs of the materials in a .blend file, read from their nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import srgb
from oaisys_core.procedural.meshes.cut_outs import cut_out
from oaisys_core.render.blender.objects.blend_images import image_pixels
from oaisys_core.scene import MeshMaterial, Wrap

WRAPS: dict[str, Wrap] = {"EXTEND": "clamp", "CLIP": "clamp", "MIRROR": "mirror"}
"""How an image goes on, by its node's extension; else it repeats."""

SHADERS = {
    "BSDF_PRINCIPLED": "Base Color",
    "BSDF_DIFFUSE": "Color",
    "EMISSION": "Color",
    "BSDF_GLOSSY": "Color",
}
"""Input with the colour of each shader, in the order in which one is chosen."""

VERTEX_COLORS = ("VERTEX_COLOR", "ATTRIBUTE")
GREY = (0.8, 0.8, 0.8)
"""Linear colour of Blender's material for surfaces without one."""


class FoundImage(NamedTuple):
    """An image node, the socket through which it was reached, and the nodes on the way."""

    node: Any
    socket: str
    passed: tuple[str, ...]


class BlendMaterial(NamedTuple):
    """A material of a file, and how its image lies on a mesh.

    Attributes:
        material: Its colours.
        uv_map: Name of the texture coordinates; empty: those that are active for rendering.
        transform: (2, 3) of texture coordinates.
        has_vertex_colors: Whether its colour is that of the vertices.
        is_plain: Whether a node decides nothing about its colour.
    """

    material: MeshMaterial
    uv_map: str
    transform: NDArray[np.float64]
    has_vertex_colors: bool
    is_plain: bool


def read_material(source: Any, warnings: list[str]) -> BlendMaterial:
    """Return a material of Blender, or of a slot without one; what is left out becomes a warning.

    Args:
        source: Blender's material, or None.
        warnings: To which sentences are added.
    """
    tree = source.node_tree if source is not None else None
    name = source.name if source is not None else "none"
    nodes = list(tree.nodes) if tree is not None else []
    shader = _shader_of(nodes)
    if shader is None:
        color = tuple(source.diffuse_color[:3]) if source is not None and not nodes else GREY
        if nodes:
            warnings.append(f"material {name!r} has no shader whose colour is known: it is grey")
        return BlendMaterial(_plain(name, color), "", np.eye(2, 3), False, source is None)
    socket = shader.inputs[SHADERS[shader.type]]
    found = _find_image(socket)
    color = tuple(socket.default_value[:3])
    if found is not None:
        _warn_of_nodes(name, found, warnings)
        return _with_image(source, found, _opacity(nodes, shader, name, warnings), warnings)
    painted = _find(socket, lambda node: node.type in VERTEX_COLORS)
    constant = _find(socket, lambda node: node.type == "RGB")
    if painted is not None:
        color = (1.0, 1.0, 1.0)
    elif constant is not None:
        color = tuple(constant.node.outputs[0].default_value[:3])
    elif socket.links:
        label = socket.links[0].from_node.name
        warnings.append(f"material {name!r}: node {label!r} is not read: the colour is plain")
    opacity = _opacity(nodes, shader, name, warnings)
    plain = _plain(name, color)
    if opacity is not None:
        plain = MeshMaterial(name, plain.color_srgb, None, opacity)
    is_plain = painted is None and not socket.links
    return BlendMaterial(plain, "", np.eye(2, 3), painted is not None, is_plain)


def images_of(source: Any) -> list[Any]:
    """Return the images that `read_material` reads, as often as it does."""
    tree = source.node_tree if source is not None else None
    nodes = list(tree.nodes) if tree is not None else []
    shader = _shader_of(nodes)
    if shader is None:
        return []
    sockets = (shader.inputs[SHADERS[shader.type]], _alpha_socket(nodes, shader)[0])
    found = [_find_image(socket) for socket in sockets if socket is not None]
    return [each.node.image for each in found if each is not None and each.node.image is not None]


def _shader_of(nodes: list[Any]) -> Any:
    return next((n for kind in SHADERS for n in nodes if n.type == kind), None)


def _plain(name: str, color: tuple[float, ...]) -> MeshMaterial:
    red, green, blue = srgb(np.clip(np.array(color, np.float64), 0, 1)).tolist()
    return MeshMaterial(name, (red, green, blue))


def _find(socket: Any, is_wanted: Any) -> FoundImage | None:
    """Return the first node upstream of a socket that is wanted, through any simple nodes."""
    left: list[tuple[Any, tuple[str, ...]]] = [(link, ()) for link in socket.links]
    seen = set()
    while left:
        link, passed = left.pop(0)
        node = link.from_node
        if node.name in seen:
            continue
        seen.add(node.name)
        if is_wanted(node):
            return FoundImage(node, link.from_socket.name, passed)
        if node.type != "REROUTE":
            passed = (*passed, node.name)
        left += [(each, passed) for entry in node.inputs for each in entry.links]
    return None


def _find_image(socket: Any) -> FoundImage | None:
    return _find(socket, lambda node: node.type == "TEX_IMAGE")


def _warn_of_nodes(name: str, found: FoundImage, warnings: list[str]) -> None:
    if found.passed:
        nodes = ", ".join(map(repr, found.passed))
        warnings.append(
            f"material {name!r}: the image {found.node.image and found.node.image.name!r} is shown"
            f" as it is, without what the nodes {nodes} do to it (bake it in Blender to keep that)"
        )


def _with_image(
    source: Any, found: FoundImage, opacity: NDArray[np.uint8] | None, warnings: list[str]
) -> BlendMaterial:
    node, name = found.node, source.name
    pixels = image_pixels(node.image)
    if pixels is None:
        image = node.image.filepath if node.image is not None else "no image"
        warnings.append(f"material {name!r}: its image is missing ({image}): the colour is plain")
        return BlendMaterial(_plain(name, GREY), "", np.eye(2, 3), False, False)
    if node.projection != "FLAT":
        warnings.append(f"material {name!r}: its {node.projection} projection is read as UV")
    along = WRAPS.get(node.extension, "repeat")
    uv_map, transform = _place(node, name, warnings)
    material = MeshMaterial(name, color_image_srgb=pixels[0], opacity=opacity, wrap=(along, along))
    return BlendMaterial(material, uv_map, transform, False, False)


def _place(node: Any, name: str, warnings: list[str]) -> tuple[str, NDArray[np.float64]]:
    """Return the texture coordinates of an image node, and their transform."""
    transform = np.eye(2, 3)
    links = node.inputs["Vector"].links
    if links and links[0].from_node.type == "MAPPING":
        mapping = links[0].from_node
        x, y = mapping.inputs["Scale"].default_value[:2]
        angle = mapping.inputs["Rotation"].default_value[2]
        cos, sin = np.cos(angle), np.sin(angle)
        transform[:, :2] = [(cos * x, -sin * y), (sin * x, cos * y)]
        transform[:, 2] = mapping.inputs["Location"].default_value[:2]
        if mapping.vector_type != "POINT":
            warnings.append(f"material {name!r}: node {mapping.name!r} is read as of type Point")
        links = mapping.inputs["Vector"].links
    if not links:
        return "", transform
    origin, socket = links[0].from_node, links[0].from_socket.name
    if origin.type == "UVMAP":
        return str(origin.uv_map), transform
    if origin.type != "TEX_COORD" or socket != "UV":
        warnings.append(f"material {name!r}: coordinates of {origin.name!r} are read as UV")
    return "", transform


def _opacity(
    nodes: list[Any], shader: Any, name: str, warnings: list[str]
) -> NDArray[np.uint8] | None:
    """Return the opacity of a material whose alpha cuts it out, or which is mixed with nothing."""
    socket, inverted = _alpha_socket(nodes, shader)
    if socket is None:
        return None
    found = _find_image(socket)
    where = f"material {name!r}"
    if found is None:
        value = float(socket.default_value)
        value = 1 - value if inverted else value
        return None if socket.links else cut_out(None, value, 0.5, where, is_mask=False)
    pixels = image_pixels(found.node.image)
    if pixels is None:
        warnings.append(f"{where}: the image of its alpha is missing: nothing is cut out")
        return None
    colors, alpha = pixels
    values = alpha if found.socket == "Alpha" else np.rint(colors.mean(axis=2)).astype(np.uint8)
    if values is None:
        return None
    opacity = np.asarray(255 - values if inverted else values, np.uint8)
    return cut_out(opacity, 1.0, 0.5, where, is_mask=True)


def _alpha_socket(nodes: list[Any], shader: Any) -> tuple[Any, bool]:
    """Return the input that cuts a material out, None without one, and whether 1 is transparent."""
    mixed = next((n for n in nodes if n.type == "MIX_SHADER" and _transparent_input(n)), None)
    if mixed is not None:
        return mixed.inputs[0], _transparent_input(mixed) == 2
    return shader.inputs.get("Alpha"), False


def _transparent_input(mixed: Any) -> int:
    """Return which input of a Mix Shader is transparent, 1 or 2; 0: none."""
    for index in (1, 2):
        links = mixed.inputs[index].links
        if links and links[0].from_node.type == "BSDF_TRANSPARENT":
            return index
    return 0
