"""The analytic backend: colour, heights, mesh, life."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_worlds import BOX, SPHERE, SUNNY, camera, flat_world, rocky_world, settings

from oaisys_core.color import encode_srgb, linear
from oaisys_core.errors import CancelledError, NotReadyError, RenderError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.render import make_backend
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import Scene
from oaisys_core.types import RGB, Progress


def built(scene: Scene) -> AnalyticBackend:
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    return backend


def test_it_is_made_by_name() -> None:
    backend = make_backend("analytic")
    assert isinstance(backend, AnalyticBackend)
    assert backend.name == "analytic"
    assert backend.version.count(".") == 2


def test_nothing_is_rendered_before_there_is_a_scene() -> None:
    with pytest.raises(NotReadyError):
        AnalyticBackend().render_all(
            [camera(pose_looking_down(0, 0, 5))], settings(), lambda _: None
        )


def test_frames_come_in_the_order_asked_for() -> None:
    down = camera(pose_looking_down(0, 0, 9), modalities=("instance", "rgb"))
    up = replace(down, name="other", modalities=("depth",))
    frames = built(flat_world()).render_all([down, up], settings(), lambda _: None)
    assert [(f.sensor, f.modality) for f in frames] == [
        ("camera", "instance"),
        ("camera", "rgb"),
        ("other", "depth"),
    ]
    assert [f.data.dtype for f in frames] == [np.uint32, np.uint8, np.float32]


def test_lambert_and_exposure_give_the_ball_its_colour() -> None:
    backend = built(flat_world())
    backend.update(
        replace(flat_world(), sky=replace(SUNNY, sun_elevation_rad=np.pi / 2, sky_strength=0.0))
    )
    view = [camera(pose_looking_down(2, 1, 9), modalities=(RGB, "instance"))]
    frames = backend.render_all(view, settings(), lambda _: None)
    brighter = backend.render_all(view, settings(exposure_ev=0.5), lambda _: None)
    row, col = 23, 31
    assert frames[1].data[row, col] == SPHERE.instance_id
    expected = linear(SPHERE.color_srgb) * SUNNY.sun_strength_w_m2 / np.pi
    np.testing.assert_allclose(linear(frames[0].data[row, col] / 255), expected, rtol=0.03)
    np.testing.assert_allclose(
        linear(brighter[0].data[row, col] / 255), np.clip(expected * 2**0.5, 0, 1), rtol=0.03
    )


def test_the_lit_side_is_the_one_towards_the_sun() -> None:
    backend = built(flat_world())
    view = [camera(pose_looking_down(2, 1, 9), modalities=(RGB, "instance"))]
    for azimuth, (d_row, d_col) in {0.0: (-1, 0), np.pi / 2: (0, -1)}.items():
        backend.update(
            replace(
                flat_world(), sky=replace(SUNNY, sun_azimuth_rad=azimuth, sun_elevation_rad=0.3)
            )
        )
        image, ids = (f.data for f in backend.render_all(view, settings(), lambda _: None))
        rows, cols = np.nonzero(ids == SPHERE.instance_id)
        side = (rows - rows.mean()) * d_row + (cols - cols.mean()) * d_col
        level = image[rows, cols].mean(axis=1)
        assert level[side > 2].mean() > level[side < -2].mean() + 20


def test_srgb_encoding_and_decoding_are_inverse() -> None:
    levels = np.arange(256)
    assert (encode_srgb(linear(levels / 255)) == levels).all()


def test_heights_are_those_of_the_topmost_surface() -> None:
    backend = built(flat_world())
    x, y, z = SPHERE.T_map_object[:3, 3]
    radius = SPHERE.size_m[0]
    xy_m = np.array([(x, y), (x + 0.9, y), (15.0, 3.0), (20.0, -20.0), (20.1, 0.0)])
    expected_m = [z + radius, z + np.sqrt(radius**2 - 0.81), 0.25, 0.25, np.nan]
    np.testing.assert_allclose(backend.surface_height_m(xy_m), expected_m, atol=1e-9)


def test_the_mesh_is_the_world_with_its_labels() -> None:
    scene = flat_world()
    mesh = built(scene).ground_truth_mesh()
    assert mesh.semantic_ids is not None
    assert mesh.instance_ids is not None
    ball = mesh.vertices_m[mesh.triangles[mesh.instance_ids == SPHERE.instance_id]]
    centres = ball.mean(axis=1) - SPHERE.T_map_object[:3, 3]
    assert 0 <= SPHERE.size_m[0] - np.linalg.norm(centres, axis=1).min() <= 5e-4
    normals = np.cross(ball[:, 1] - ball[:, 0], ball[:, 2] - ball[:, 0])
    assert ((normals * centres).sum(axis=1) > 0).all()

    box = mesh.vertices_m[mesh.triangles[mesh.instance_ids == BOX.instance_id]]
    volume_m3 = np.einsum("ij,ij->i", box[:, 0], np.cross(box[:, 1], box[:, 2])).sum() / 6
    assert volume_m3 == pytest.approx(np.prod(BOX.size_m))

    ground = mesh.instance_ids == 0
    assert ground.sum() == len(scene.ground.triangles())
    assert set(np.unique(mesh.semantic_ids[ground])) == {1, 2}


def test_rocks_stand_where_they_were_placed() -> None:
    scene = rocky_world()
    mesh = built(scene).ground_truth_mesh()
    assert mesh.instance_ids is not None
    placement, rock = scene.placements[0], scene.prototypes[0]
    for index in (0, 41):
        T = placement.T_map_object[index]
        own = mesh.triangles[mesh.instance_ids == placement.instance_ids[index]]
        assert len(own) == len(rock.triangles)
        expected = rock.vertices_m[rock.triangles[5]] @ T[:3, :3].T + T[:3, 3]
        np.testing.assert_allclose(mesh.vertices_m[own[5]], expected, atol=1e-6)


def test_progress_may_cancel_and_leaves_no_half_world() -> None:
    def cancel(progress: Progress) -> None:
        if progress.stage == "ground":
            raise CancelledError("enough")

    backend = built(flat_world())
    with pytest.raises(CancelledError):
        backend.build(rocky_world(), cancel)
    with pytest.raises(NotReadyError):
        backend.ground_truth_mesh()


def test_an_unknown_shape_is_refused() -> None:
    scene = replace(flat_world(), primitives=(replace(BOX, shape="torus"),))
    with pytest.raises(RenderError, match="torus"):
        built(scene)


def test_a_view_from_within_sees_the_far_side() -> None:
    backend = built(flat_world())
    x, y, z = SPHERE.T_map_object[:3, 3]
    view = [camera(pose_looking_at((x, y, z), (x + 1, y, z)), modalities=("depth",))]
    depth_m = backend.render_all(view, settings(), lambda _: None)[0].data
    assert depth_m.max() <= SPHERE.size_m[0]
