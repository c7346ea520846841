"""What the tests of mesh files do inside Blender."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.render.blender.objects.meshes import new_mesh, new_object
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata


def save_blend(path: str, script_writes: str) -> None:
    """Save a file with two pyramids, one of them modified and moved, and a script that writes."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
    triangles = [(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    for name in ("small", "tall"):
        mesh = new_mesh(name, vertices, triangles, smooth=False)
        material = bpy.data.materials.new(name)
        if material.node_tree is None:
            material.use_nodes = True
        shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = (1.0, 0.0, 0.0, 1.0)
        mesh.materials.append(material)
        thing = new_object(name, mesh, np.eye(4))
        if name == "tall":
            thing.location, thing.scale = (10.0, 0.0, 0.0), (1.0, 1.0, 3.0)
            thing.modifiers.new("array", "ARRAY").count = 2
    text = bpy.data.texts.new("attack.py")
    text.write(f"open({script_writes!r}, 'w')")
    text.use_module = True
    bpy.ops.wm.save_as_mainfile(filepath=path)


def refused_stage(config: Mapping[str, Any], metadata: ModuleMetadata) -> str:
    """What a batch with the metadata is refused for; empty: it is not."""
    simulation = Simulation(config_from_mapping(config))
    try:
        simulation.step_batch(metadata)
    except InvalidInputError as error:
        return str(error)
    return ""


def save_linked_blends(folder: str) -> None:
    """Save one .blend file for each way to refer to another file, and some that refer to none."""
    for kind, link in LINKS.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.mesh.primitive_cube_add()
        link(bpy.context.object, Path(folder))
        bpy.ops.wm.save_as_mainfile(filepath=str(Path(folder, "root", f"{kind}.blend")))
    # A driver that is still there when the process ends keeps it from ending.
    bpy.ops.wm.read_factory_settings(use_empty=True)


def _driver(thing: Any, _: Path) -> None:
    thing.driver_add("location", 0).driver.expression = "len(str(frame)) * 2.0"


def save_driven_blend(path: str, expression: str) -> None:
    """Save a cube whose x scale and shape are driven by an expression; the saved values are 3."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    cube.shape_key_add(name="basis")
    longer = cube.shape_key_add(name="longer")
    for point in longer.data:
        point.co.y *= 2
    longer.slider_max = 5
    # Out of the scene nothing is evaluated, so that the saved values stay.
    bpy.context.scene.collection.objects.unlink(cube)
    cube.use_fake_user = True
    for curve in (cube.driver_add("scale", 0), longer.driver_add("value")):
        curve.driver.type = "SCRIPTED"
        curve.driver.expression = expression
    cube.scale[0] = longer.value = 3.0
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)


def _image(thing: Any, path: Path) -> None:
    pixels = bpy.data.images.new("pixels", 4, 4)
    pixels.filepath_raw = str(path)
    pixels.file_format = "PNG"
    pixels.save()
    _paint(thing, bpy.data.images.load(str(path)))


def _paint(thing: Any, image: Any) -> None:
    material = bpy.data.materials.new("textured")
    material.use_nodes = True
    tree = material.node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    tree.links.new(tree.nodes["Principled BSDF"].inputs["Base Color"], node.outputs["Color"])
    thing.data.materials.append(material)


def _library(thing: Any, folder: Path) -> None:
    other = folder / "outside" / "library.blend"
    bpy.data.libraries.write(str(other), {thing.data})
    with bpy.data.libraries.load(str(other), link=True) as (source, target):
        target.meshes = source.meshes
    thing.data = target.meshes[0]


def _cache(thing: Any, folder: Path) -> None:
    thing.modifiers.new("cache", "MESH_CACHE").filepath = str(folder / "outside" / "cache.pc2")


def _reading_node(thing: Any, _: Path) -> None:
    tree = bpy.data.node_groups.new("reading", "GeometryNodeTree")
    tree.nodes.new("GeometryNodeImportText" if bpy.app.version >= (4, 5) else "GeometryNodeJoin")
    thing.modifiers.new("reading", "NODES").node_group = tree


def _bake(thing: Any, folder: Path) -> None:
    tree = bpy.data.node_groups.new("baked", "GeometryNodeTree")
    modifier = thing.modifiers.new("baked", "NODES")
    modifier.node_group = tree
    modifier.bake_directory = str(folder / "outside" / "bake")


LINKS: dict[str, Callable[[Any, Path], None]] = {
    "driver": _driver,
    "image_inside": lambda thing, folder: _image(thing, folder / "root" / "inside.png"),
    "image_outside": lambda thing, folder: _image(thing, folder / "outside" / "secret.png"),
    "library": _library,
    "cache": _cache,
    "reading_node": _reading_node,
    "bake": _bake,
}


def render_sample(config: Mapping[str, Any], metadata: ModuleMetadata) -> dict[str, Any]:
    """The images of a sample by modality."""
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    return {frame.modality: frame.data for frame in simulation.step_sample(metadata).frames}


def save_textured_files(folder: str) -> None:
    """Save files of Blender whose shape or colour is not simply in them."""
    top = Path(folder)
    for name, make in TEXTURED.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=8, y_subdivisions=8, size=2)
        make(bpy.context.object, top)
        bpy.ops.wm.save_as_mainfile(filepath=str(top / f"{name}.blend"))
    if "usd_export" in dir(bpy.ops.wm):
        bpy.ops.wm.usd_export(filepath=str(top / "plain.usda"))
    if "collada_export" in dir(bpy.ops.wm):
        bpy.ops.wm.collada_export(filepath=str(top / "plain.dae"))


def _noise(thing: Any, _: Path) -> None:
    modifier = thing.modifiers.new("Bumps", "DISPLACE")
    modifier.texture = bpy.data.textures.new("Random", "NOISE")


def _shader(thing: Any) -> tuple[Any, Any, Any]:
    """A new material's tree, its shader, and a node of a packed image: its upper half is red."""
    material = bpy.data.materials.new("skin")
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    thing.data.materials.append(material)
    image = bpy.data.images.new("rock", 4, 4, alpha=True)
    pixels = np.zeros((4, 4, 4), np.float32)
    pixels[2:] = (1, 0, 0, 1)
    pixels[:2] = (0, 0, 1, 0)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    return tree, shader, node


def _curves(thing: Any, _: Path) -> None:
    tree, shader, node = _shader(thing)
    curves = tree.nodes.new("ShaderNodeRGBCurve")
    curves.name = "Darker"
    tree.links.new(node.outputs["Color"], curves.inputs["Color"])
    tree.links.new(curves.outputs["Color"], shader.inputs["Base Color"])


def _leaf(thing: Any, _: Path) -> None:
    tree, shader, node = _shader(thing)
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    tree.links.new(node.outputs["Alpha"], shader.inputs["Alpha"])


def _procedural(thing: Any, _: Path) -> None:
    tree, shader, _ = _shader(thing)
    node = tree.nodes.new("ShaderNodeTexVoronoi")
    node.name = "Cells"
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])


def _plain(thing: Any, _: Path) -> None:
    _, shader, _ = _shader(thing)
    shader.inputs["Base Color"].default_value = (0.064, 0.5, 0.2, 1.0)


TEXTURED: dict[str, Callable[[Any, Path], None]] = {
    "noise": _noise,
    "curves": _curves,
    "leaf": _leaf,
    "procedural": _procedural,
    "plain": _plain,
}
"""``plain`` is last, because the other formats are written of it."""


def save_blend_with_image(path: str, image_file: str) -> None:
    """Save a cube with an image as its colour, packed into the file; "": a generated one."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    if image_file:
        image = bpy.data.images.load(image_file)
        image.pack()
    else:
        image = bpy.data.images.new("generated", 4, 4)
        image.generated_width = image.generated_height = 20_000
    _paint(bpy.context.object, image)
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)


def save_instances(path: str) -> None:
    """Save a cube, an empty that shows it again 5 m away, a text, and what has no surface."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    shown = bpy.data.collections.new("shown")
    shown.objects.link(bpy.context.object)
    bpy.ops.object.collection_instance_add(collection="shown", location=(5, 0, 0))
    bpy.context.object.name = "again"
    bpy.ops.object.text_add()
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.ops.object.light_add()
    bpy.ops.object.empty_add()
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)


def save_blend_of_many_images(path: str, image_file: str, count: int, use: str) -> None:
    """Save a cube with many packed images: as its materials' colours, or in what displaces it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    for _ in range(count):
        image = bpy.data.images.load(image_file, check_existing=False)
        image.pack()
        if use == "colour":
            _paint(cube, image)
        else:
            texture = bpy.data.textures.new("image", "IMAGE")
            texture.image = image
            cube.modifiers.new("displace", "DISPLACE").texture = texture
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)


def save_blend_of_arrays(path: str, arrays: list[dict[str, Any]]) -> None:
    """Save a cube of 2 m with array modifiers of these values, and one without."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "plain"
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "copied"
    for values in arrays:
        modifier = bpy.context.object.modifiers.new("array", "ARRAY")
        for name, value in values.items():
            setattr(modifier, name, value)
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)


def save_blend_placed_nowhere(path: str, name: str) -> None:
    """Save a cube whose ``location`` or ``scale`` is no number along x."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    setattr(bpy.context.object, name, (float("nan"), 1.0, 1.0))
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)


def save_ocean(path: str) -> None:
    """Save an ocean of 16 x 16 cells of which nothing is baked."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    ocean = bpy.context.object.modifiers.new("ocean", "OCEAN")
    ocean.viewport_resolution = ocean.resolution = 4
    assert ocean.filepath.endswith("cache_ocean")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
