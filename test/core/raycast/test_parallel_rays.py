"""Which parallel rays may hit boxes: all that do, and few others."""

import numpy as np

from oaisys_core.raycast.parallel_rays import ShadowPlane
from oaisys_core.types import FloatArray


def hits(
    origins_m: FloatArray, ray: FloatArray, low_m: FloatArray, high_m: FloatArray
) -> FloatArray:
    """Whether rays hit any box, by the slab method."""
    enter = (np.where(ray > 0, low_m, high_m)[None] - origins_m[:, None]) / ray
    leave = (np.where(ray > 0, high_m, low_m)[None] - origins_m[:, None]) / ray
    return np.asarray((enter.max(-1) <= leave.min(-1)).any(axis=1))


def test_every_ray_that_hits_a_box_is_found_and_few_others() -> None:
    rng = np.random.default_rng(3)
    low_m = rng.uniform((-20, -20, 0), (20, 20, 2), (200, 3))
    high_m = low_m + rng.uniform(0.1, 0.8, (200, 3))
    origins_m = rng.uniform((-25, -25, -1), (25, 25, 1), (5000, 3))
    for ray in ((0.3, -0.5, 0.4), (-0.9, 0.1, 0.1), (0.01, 0.01, 1.0)):
        direction = np.array(ray) / np.linalg.norm(ray)
        found = ShadowPlane(direction, low_m, high_m).may_hit(origins_m)
        true = hits(origins_m, direction, low_m, high_m)
        assert found[true].all()
        assert found.mean() < 3 * true.mean() + 0.1
