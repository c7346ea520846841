"""What samples change in a built world is seen at once, in every backend."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import BOX, CENTRED, SPHERE, camera, flat_world, rocky_world, settings

from oaisys_core.geometry import pose_looking_down, transform
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.targets.ground_target import ground_mesh
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import HeightField, Placement, Scene
from oaisys_core.types import DEPTH, INSTANCE, SEMANTIC_0

BACKENDS = ["analytic", pytest.param("blender", marks=pytest.mark.blender)]

XY_M = np.random.default_rng(1).uniform(-19, 19, (300, 2))
VIEW = camera(pose_looking_down(0.5, 0.2, 10.0), CENTRED, (DEPTH, SEMANTIC_0, INSTANCE))


@cache
def worlds() -> tuple[Scene, ...]:
    """A rocky world, then one thing after another changed in it."""
    first = rocky_world()
    rocks = first.placements[0]
    half = len(rocks.instance_ids) // 2
    still = Placement(0, (10,), rocks.T_map_object[:half], rocks.instance_ids[:half])
    rover = Placement(0, (11,), rocks.T_map_object[half:], rocks.instance_ids[half:], True)
    first = replace(first, placements=(still, rover), primitives=(BOX,))
    shift = transform(np.eye(3), (0.7, -0.4, 0.3))
    moved = replace(rover, T_map_object=shift @ rover.T_map_object)
    second = replace(first, placements=(still, moved))
    sphere = replace(SPHERE, T_map_object=transform(np.eye(3), (1.0, 2.0, 2.5)))
    third = replace(second, primitives=(BOX, sphere))
    hidden = replace(
        still, T_map_object=still.T_map_object[3:], instance_ids=still.instance_ids[3:]
    )
    fourth = replace(third, placements=(hidden, moved), primitives=(sphere,))
    ground = first.ground
    assert isinstance(ground, HeightField)
    higher = replace(ground, elevation_m=ground.elevation_m + np.float32(0.5))
    fifth = replace(fourth, ground=higher, stage_hash="higher")
    flat = replace(fifth, ground=flat_world().ground, stage_hash="flat", placements=())
    return (first, second, third, fourth, fifth, flat, first)


@cache
def updated(backend: str) -> list[dict[str, Any]]:
    """Mesh, heights and images of each world, each made of the one before."""
    scenes, views = worlds(), [VIEW] * len(worlds())
    if backend == "blender":
        frames = in_blender("passes.samples", scenes, views)
        surfaces = in_blender("passes.updated_surface", scenes, XY_M)
        return [_found(f, *s) for f, s in zip(frames, surfaces, strict=True)]
    analytic = AnalyticBackend()
    found = []
    for index, scene in enumerate(scenes):
        if index:
            analytic.update(scene)
        else:
            analytic.build(scene, lambda _: None)
        found.append(_seen(analytic))
    return found


def _seen(backend: AnalyticBackend) -> dict[str, Any]:
    frames = backend.render_all([VIEW], settings(), lambda _: None)
    return _found(frames, backend.ground_truth_mesh(), backend.surface_height_m(XY_M))


def _found(frames: Any, mesh: Any, height_m: Any) -> dict[str, Any]:
    return {frame.modality: frame.data for frame in frames} | {"mesh": mesh, "height_m": height_m}


@pytest.mark.long
@pytest.mark.parametrize("step", range(7))
@pytest.mark.parametrize("backend", BACKENDS)
def test_an_updated_world_is_as_one_built_anew(backend: str, step: int) -> None:
    seen = updated(backend)[step]
    fresh = AnalyticBackend()
    fresh.build(worlds()[step], lambda _: None)
    expected = _seen(fresh)
    np.testing.assert_allclose(seen["height_m"], expected["height_m"], atol=1e-4)
    same = seen[INSTANCE] == expected[INSTANCE]
    assert same.mean() > 0.998
    assert (seen[SEMANTIC_0] == expected[SEMANTIC_0]).mean() > 0.998
    close = np.isclose(seen[DEPTH][same], expected[DEPTH][same], rtol=1e-5)
    assert close.mean() > 0.998
    mesh, wanted = seen["mesh"], expected["mesh"]
    assert len(mesh.triangles) == len(wanted.triangles)
    for low in (np.min, np.max):
        np.testing.assert_allclose(
            low(mesh.vertices_m, axis=0), low(wanted.vertices_m, axis=0), atol=1e-5
        )
    assert (np.bincount(mesh.instance_ids) == np.bincount(wanted.instance_ids)).all()


def test_every_step_shows_in_the_images() -> None:
    seen = updated("analytic")
    for before, after in pairwise(seen):
        assert (before[DEPTH] != after[DEPTH]).any()
    assert (seen[0][DEPTH] == seen[-1][DEPTH]).all()


def test_what_moves_leaves_the_structures_of_all_else_alone() -> None:
    first, second, *_ = worlds()
    surface = Surface(first, ground_mesh(first))
    before = list(surface._targets)
    surface.update_objects(second)
    after = list(surface._targets)
    assert after[:2] == before[:2]
    assert after[2] is not before[2]
