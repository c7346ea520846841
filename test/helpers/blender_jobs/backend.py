"""What tests have done in Blender's own process, see `blender_process.in_blender`."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest import mock

import bpy
import numpy as np
from cycles import CyclesRender
from numpy.typing import NDArray
from synthetic_worlds import BOX, SUNNY, camera, rocky_world, settings, with_separate_rocks

from oaisys_core.errors import CancelledError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.render.blender import BlenderBackend, cycles
from oaisys_core.scene import PlacedCamera, Primitive, Scene
from oaisys_core.types import RGB, FloatArray, Frame, PinholeIntrinsics, Progress, TriangleMesh
from tools.bench.cycles_passes import FILTER_WIDTH_PX


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def views(scene: Scene, cameras: Sequence[PlacedCamera]) -> tuple[Frame, ...]:
    """Frames of a world."""
    backend = BlenderBackend()
    backend.build(scene, ignore)
    return backend.render_all(cameras, settings(), ignore)


def passes(
    scene: Scene, cameras: Sequence[PlacedCamera]
) -> list[tuple[tuple[Frame, ...], NDArray[Any], NDArray[Any]]]:
    """Frames of a world, each with Cycles' own depth and object index of the same render.

    One sample through the middle of the pixel: these passes are those of the first sample.
    """
    backend = BlenderBackend()
    backend.build(scene, ignore)
    blender_scene = bpy.context.scene
    for thing in blender_scene.objects:
        if thing.name.startswith("instance_"):
            thing.pass_index = int(thing.name.removeprefix("instance_"))
    layer = blender_scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_object_index = True
    result = []
    through_middle = mock.patch.object(cycles, "CYCLES_WIDTH_PX", FILTER_WIDTH_PX)
    with through_middle, recorded_passes() as seen:
        for each in cameras:
            frames = backend.render_all([each], settings(samples=1), ignore)
            index = next(seen[name] for name in ("IndexOB", "Object Index") if name in seen)
            result.append((frames, seen["Depth"], np.rint(index).astype(np.uint32)))
    return result


def life() -> dict[str, Any]:
    """What a backend holds and shows through builds, cancelling and changes of light."""
    scene = with_separate_rocks(rocky_world())
    view = [camera(pose_looking_down(0, 0, 9), modalities=(RGB,))]
    backend = BlenderBackend()
    found: dict[str, Any] = {"version": backend.version}

    def blocks() -> dict[str, int]:
        kinds = ("objects", "meshes", "materials")
        images = [image for image in bpy.data.images if image.type != "RENDER_RESULT"]
        return {"images": len(images)} | {kind: len(getattr(bpy.data, kind)) for kind in kinds}

    backend.build(scene, ignore)
    found["first"] = blocks()
    ground = bpy.data.objects["ground"].data
    other = replace(scene, placements=(), primitives=(replace(BOX, instance_id=1),))
    backend.build(other, ignore)
    found["ground kept"] = bpy.data.objects["ground"].data == ground
    found["without rocks"] = blocks()
    backend.build(replace(scene, stage_hash="another"), ignore)
    found["again"] = blocks()

    found["sunny"] = backend.render_all(view, settings(4), ignore)[0].data
    found["brighter"] = backend.render_all(view, settings(4, exposure_ev=1.0), ignore)[0].data
    backend.update(replace(scene, sky=replace(SUNNY, sun_elevation_rad=-0.2)))
    found["night"] = backend.render_all(view, settings(4), ignore)[0].data
    try:
        backend.build(scene, _cancel_at_objects)
    except CancelledError:
        found["cancelled"] = True
    backend.build(scene, ignore)
    found["after cancelling"] = blocks()
    backend.close()
    return found


def pictures_by_samples(counts: Sequence[int]) -> list[NDArray[Any]]:
    """The same view with so many samples, one after the other."""
    backend = BlenderBackend()
    backend.build(rocky_world(), ignore)
    small = PinholeIntrinsics(32, 24, 27.0, 27.0, 15.5, 11.5)
    view = camera(pose_looking_down(0, 0, 9), small, (RGB,))
    return [backend.render_all([view], settings(count), ignore)[0].data for count in counts]


def moves() -> dict[str, tuple[int, NDArray[Any], NDArray[Any]]]:
    """Colour after each of several changes, beside that of a session that knows of nothing else.

    First the number of things that Cycles was told to look at again.
    """
    marks: list[int] = []
    before = CyclesRender.update

    def update(engine: Any, data: Any, depsgraph: Any) -> None:
        marks.append(len(depsgraph.updates))
        before(engine, data, depsgraph)

    scene = replace(rocky_world(), primitives=(replace(BOX, instance_id=900),))
    box = replace(BOX, instance_id=900, T_map_object=BOX.T_map_object @ np.diag([1, 1, 2, 1.0]))
    first = camera(pose_looking_down(0, 0, 9), modalities=(RGB,))
    aside = camera(pose_looking_down(1.5, 0, 9), modalities=(RGB,))
    wide = replace(first, intrinsics=replace(first.intrinsics, fx_px=40.0, fy_px=40.0))
    evening = replace(SUNNY, sun_elevation_rad=0.2)
    steps = {
        "begins": (scene, first, settings(4)),
        "moved": (scene, aside, settings(4)),
        "more samples": (scene, first, settings(16)),
        "other lens": (scene, wide, settings(4)),
        "fewer bounces": (scene, aside, replace(settings(4), max_bounces=0)),
        "denoised": (scene, first, replace(settings(4), denoise=True)),
        "other light": (replace(scene, sky=evening), aside, settings(4)),
        "moved box": (replace(scene, primitives=(box,)), first, settings(4)),
    }
    backend = BlenderBackend()
    backend.build(scene, ignore)
    found = {}
    with mock.patch.object(CyclesRender, "update", update):
        for name, (now, view, wanted) in steps.items():
            backend.update(now)
            image = backend.render_all([view], wanted, ignore)[0].data
            count = marks[-1]
            backend._cycles.free_persistent_data()
            alone = backend.render_all([view], wanted, ignore)[0].data
            found[name] = (count, image, alone)
            # The next change shall meet a session that has rendered this one.
            backend.render_all([view], wanted, ignore)
    return found


def shadow(sun_azimuth_rad: float, box: Primitive) -> tuple[Frame, ...]:
    """A level ground with a box in low sun, from above, in colour."""
    from synthetic_worlds import flat_world

    sky = replace(SUNNY, sun_azimuth_rad=sun_azimuth_rad, sky_strength=0.2)
    scene = replace(flat_world(), primitives=(box,), sky=sky)
    return views(scene, [camera(pose_looking_down(0, 0, 12), modalities=(RGB,))])


def surface(scene: Scene, xy_m: FloatArray) -> tuple[TriangleMesh, FloatArray]:
    """A world's mesh, and its heights at points."""
    backend = BlenderBackend()
    backend.build(scene, ignore)
    return backend.ground_truth_mesh(), backend.surface_height_m(xy_m)


def _cancel_at_objects(progress: Progress) -> None:
    if progress.stage == "objects":
        raise CancelledError("enough")


@contextmanager
def recorded_passes() -> Iterator[dict[str, NDArray[Any]]]:
    """Have each render leave its passes, (H, W) float32, in a dictionary during a block."""
    engine: Any = importlib.import_module("cycles").CyclesRender
    seen: dict[str, NDArray[Any]] = {}
    original = engine.render

    def render(self: Any, depsgraph: Any) -> None:
        original(self, depsgraph)
        result = self.get_result()
        for each in result.layers[0].passes:
            values = np.empty((result.resolution_y, result.resolution_x, each.channels), np.float32)
            each.rect.foreach_get(values.ravel())
            seen[each.name] = values[::-1, :, 0]

    with mock.patch.object(engine, "render", render):
        yield seen
