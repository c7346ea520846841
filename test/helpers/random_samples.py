"""A sample of random images, and a comparison that goes down to every bit of every field."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from oaisys_core.types import Frame, Odometry, PinholeIntrinsics, Pose, Provenance, Sample

POSE = Pose((1.25, -2.5, 1e-9), (0.5, -0.5, 0.5, math.sqrt(0.25)))
BENT = PinholeIntrinsics(640, 480, 541.14, 540.9, 319.5, 239.25, (-0.2, 0.05, 1e-3, 0.0, 1e-9))
T = np.random.default_rng(1).normal(size=(4, 4))
PROVENANCE = Provenance(
    *(2**62, 2**63 - 1, "a" * 64, "blender", "5.2.3", "high", 16, "optix", 2**61, 2**60),
    '{"environment":{"dust":[1.0,2.0]}}',
    '{"left":{"position_m":[1.0,2.0,3.0],"quat_xyzw":[0.0,0.0,0.0,1.0]}}',
)


def make_sample(height_px: int = 480, width_px: int = 640) -> Sample:
    rng = np.random.default_rng(2)
    size = (height_px, width_px)
    depth_m = rng.uniform(0, 50, size).astype(np.float32)
    depth_m[0] = np.inf
    images: dict[str, Any] = {
        "rgb": rng.integers(0, 256, (*size, 3), dtype=np.uint8),
        "depth": depth_m,
        "semantic_0": rng.integers(0, 2**16, size, dtype=np.uint16),
        "instance": rng.integers(0, 2**32, size, dtype=np.uint32),
        "normal": rng.normal(size=(*size, 3)).astype(np.float32),
        "flow": np.full((*size, 2), np.nan, np.float32),
    }
    frames = tuple(Frame("left", name, data, BENT, T) for name, data in images.items())
    odometry = Odometry(Pose((1.0, 2.0, 3.5), (0.0, 0.0, 1.0, 0.0)), 0.5, 0.125)
    return Sample(3, 9, POSE, frames, 0.25, PROVENANCE, odometry=odometry)


def assert_same(a: Any, b: Any) -> None:
    """Equal in every field, type and bit."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes()
    elif is_dataclass(a):
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple | list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    else:
        assert a == b
