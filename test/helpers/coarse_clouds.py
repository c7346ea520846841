"""Pictures of clouds with a sixteenth of the directions, for tests of what is done with them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from unittest import mock

from oaisys_core.procedural.environment.clouds import daylight, dome, shadows

CACHES = (
    *(dome.cloud_dome, dome.cloud_image, dome._image_around),
    *(daylight.daylight_factors, shadows.cloud_shadows),
)
"""What remembers the clouds of a sky."""


BLENDER_NODES = "oaisys_core.render.blender.objects.clouds"
"""What knows the number of rows, too, where Blender is."""


@contextmanager
def coarse_clouds() -> Iterator[None]:
    """Look at clouds in fewer directions meanwhile: all of them take three seconds a sky."""
    rows, columns = dome.ROWS // 4, dome.COLUMNS // 4
    with ExitStack() as stack:
        stack.callback(_forget_clouds)
        for module in (dome, daylight):
            stack.enter_context(mock.patch.multiple(module, ROWS=rows, COLUMNS=columns))
        if "bpy" in sys.modules:
            nodes = importlib.import_module(BLENDER_NODES)
            stack.enter_context(mock.patch.object(nodes, "ROWS", rows))
        _forget_clouds()
        yield


def _forget_clouds() -> None:
    for cached in CACHES:
        cached.cache_clear()
