"""A frozen scene whose render time measures the machine's speed.

``python -m tools.bench.calibration_scene`` reads numbers of samples per pixel from standard input,
one per line, and writes the seconds of a render of each. It is built with ``bpy`` alone, without
textures and without code of this project, so that changes of the project cannot change it. Do not
change it either: ratios to it are compared between commits.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time

import bpy
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, HEIGHT_PX = 640, 480
EDGE_M, POINTS = 40.0, 257
ROCKS = 200
RINGS, SECTORS = 12, 20
GOLDEN_RATIO = (1 + math.sqrt(5)) / 2

Vertices = NDArray[np.float64]
Faces = list[tuple[int, ...]]


def build() -> None:
    """Replace Blender's scene by the frozen one."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _add("ground", *_ground())
    rock = _mesh("rock", *_rock())
    for index in range(1, ROCKS + 1):
        # Points of a low-discrepancy sequence, which no library's generator can change.
        x_m = EDGE_M * (index * GOLDEN_RATIO % 1 - 0.5)
        y_m = EDGE_M * (index * GOLDEN_RATIO**2 % 1 - 0.5)
        placed = bpy.data.objects.new(f"rock {index}", rock)
        placed.location = (x_m, y_m, float(_height_m(np.array(x_m), np.array(y_m))))
        placed.scale = (0.2 + 0.8 * (index * math.sqrt(2) % 1),) * 3
        placed.rotation_euler = (0.0, 0.0, float(index))
        bpy.context.scene.collection.objects.link(placed)
    _add_light()
    _add_camera()
    _set_up_cycles()


def _height_m(x_m: Vertices, y_m: Vertices) -> Vertices:
    waves = np.sin(0.5 * x_m) * np.cos(0.4 * y_m) + 0.3 * np.sin(1.7 * x_m + 2.1 * y_m)
    return np.asarray(waves + 0.05 * np.sin(7.0 * x_m) * np.sin(6.0 * y_m))


def _ground() -> tuple[Vertices, Faces]:
    along_m = np.linspace(-EDGE_M / 2, EDGE_M / 2, POINTS)
    x_m, y_m = np.meshgrid(along_m, along_m)
    vertices = np.column_stack((x_m.ravel(), y_m.ravel(), _height_m(x_m, y_m).ravel()))
    corner = np.arange(POINTS * (POINTS - 1)).reshape(POINTS - 1, POINTS)[:, :-1].ravel()
    faces = np.column_stack((corner, corner + 1, corner + POINTS + 1, corner + POINTS))
    return vertices, list(map(tuple, faces.tolist()))


def _rock() -> tuple[Vertices, Faces]:
    """Return a dented sphere of radius 1; its poles are small holes under and over it."""
    polar = np.linspace(0.02, math.pi - 0.02, RINGS)
    around = np.linspace(0, 2 * math.pi, SECTORS, endpoint=False)
    theta, phi = np.meshgrid(polar, around, indexing="ij")
    radius = 1 + 0.15 * np.sin(3 * phi) * np.sin(theta) ** 2 + 0.1 * np.cos(5 * theta)
    vertices = np.column_stack(
        (
            (radius * np.sin(theta) * np.cos(phi)).ravel(),
            (radius * np.sin(theta) * np.sin(phi)).ravel(),
            (0.7 * radius * np.cos(theta)).ravel(),
        )
    )
    faces: Faces = []
    for ring in range(RINGS - 1):
        for sector in range(SECTORS):
            after = (sector + 1) % SECTORS
            low, high = ring * SECTORS, (ring + 1) * SECTORS
            faces.append((low + sector, high + sector, high + after, low + after))
    return vertices, faces


def _mesh(name: str, vertices: Vertices, faces: Faces) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces)
    mesh.update()
    return mesh


def _add(name: str, vertices: Vertices, faces: Faces) -> None:
    placed = bpy.data.objects.new(name, _mesh(name, vertices, faces))
    bpy.context.scene.collection.objects.link(placed)


def _add_light() -> None:
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 4.0, math.radians(0.53)
    placed = bpy.data.objects.new("sun", sun)
    placed.rotation_euler = (math.radians(50.0), 0.0, math.radians(30.0))
    bpy.context.scene.collection.objects.link(placed)
    sky = bpy.data.worlds.new("sky")
    sky.use_nodes = True
    nodes = sky.node_tree.nodes
    nodes.clear()
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (0.3, 0.4, 0.6, 1.0)
    output = nodes.new("ShaderNodeOutputWorld")
    sky.node_tree.links.new(background.outputs[0], output.inputs["Surface"])
    bpy.context.scene.world = sky


def _add_camera() -> None:
    lens = bpy.data.cameras.new("camera")
    lens.angle = math.radians(61.0)
    placed = bpy.data.objects.new("camera", lens)
    placed.location = (-12.0, -12.0, 6.0)
    placed.rotation_euler = (math.radians(65.0), 0.0, math.radians(-45.0))
    bpy.context.scene.collection.objects.link(placed)
    bpy.context.scene.camera = placed


def _set_up_cycles() -> None:
    render = bpy.context.scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = WIDTH_PX, HEIGHT_PX
    render.resolution_percentage = 100
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    render.threads_mode = "FIXED"
    render.threads = len(os.sched_getaffinity(0))
    cycles = bpy.context.scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
    cycles.max_bounces = 2
    cycles.seed = 1


def render_s(samples: int) -> float:
    """Return the seconds of a render with a number of samples per pixel."""
    scene = bpy.context.scene
    if scene.cycles.samples != samples:
        scene.cycles.samples = samples
        # Without it, Blender renders its copy of the scene, with the old number.
        scene.update_tag()
    started_s = time.perf_counter()
    bpy.ops.render.render()
    return time.perf_counter() - started_s


def main() -> None:
    """Answer each line of standard input until its end."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    answers = os.fdopen(os.dup(1), "w", encoding="ascii", buffering=1)
    os.dup2(2, 1)  # Blender prints while it renders
    build()
    for line in sys.stdin:
        answers.write(f"{render_s(int(line)):.6f}\n")


if __name__ == "__main__":
    main()
