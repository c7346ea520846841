"""Plain typed data: what a person sees of it."""

from __future__ import annotations

import numpy as np

from oaisys_core.types import (
    Frame,
    HeightQuery,
    PinholeIntrinsics,
    Pose,
    Provenance,
    Sample,
    SensorInfo,
    TriangleMesh,
)

INTRINSICS = PinholeIntrinsics(640, 480, 540.0, 540.0, 319.5, 239.5)


def test_a_sample_is_shown_in_a_few_lines_without_its_pixels() -> None:
    frames = tuple(
        Frame("camera", modality, np.zeros(shape, dtype), INTRINSICS, np.eye(4))
        for modality, shape, dtype in (
            ("rgb", (480, 640, 3), np.uint8),
            ("depth", (480, 640), np.float32),
        )
    )
    provenance = Provenance(1, 2, "0" * 64, "analytic", "0.1.0", "standard", 0)
    pose = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    sample = Sample(1, 2, pose, frames, 0.5, provenance)
    shown = repr(sample)
    assert "data=<float32 (480, 640)>" in shown
    assert "data=<uint8 (480, 640, 3)>" in shown
    assert "T_map_camera=<float64 (4, 4)>" in shown
    assert "sensor='camera', modality='depth'" in shown
    assert "\n" not in shown
    assert "array(" not in shown
    assert len(shown) < 1500


def test_meshes_heights_and_sensors_are_shown_without_their_numbers() -> None:
    mesh = TriangleMesh(np.zeros((3, 3)), np.zeros((1, 3), np.int32))
    expected = (
        "TriangleMesh(vertices_m=<float64 (3, 3)>, triangles=<int32 (1, 3)>, "
        "semantic_ids=None, instance_ids=None)"
    )
    assert repr(mesh) == expected
    heights = HeightQuery(*(np.zeros(1000) for _ in range(3)))
    assert "clearance_m=<float64 (1000,)>" in repr(heights)
    assert "T_base_camera=<float64 (4, 4)>" in repr(SensorInfo("c", INTRINSICS, np.eye(4), ()))
