"""What a worker holds after each of many worlds: ``python worker_memory.py FOLDER WORLDS``.

Prints the memory that is in use after each world, in MB, as JSON. The worlds are written to FOLDER.
"""

from __future__ import annotations

import ctypes
import gc
import json
import sys
from typing import Any

from endurance import resident_bytes
from small_datasets import SCANNED, SMALL

from oaisys_core.config import canonical_json, config_from_mapping
from oaisys_dataset.manifest import WorldLegend
from oaisys_dataset.plan import WorldTask
from oaisys_dataset.rendering.workers import render_world

(CAMERA,) = SMALL["sensors"]["cameras"]
LARGER = {"width_px": 192, "height_px": 144, "fx_px": 160.0, "fy_px": 150.0}
WORLDS: dict[str, Any] = {
    **SCANNED,
    "stage": {"extent_m": 20.0, "resolution_px": 33},
    "materials": {"texture_size_px": 16, "mask": {"size_px": 16}},
    "assets": {"rocks": [{"count": [10, 10], "size_m": [0.5, 1.5]}]},
    "sensors": {**SCANNED["sensors"], "cameras": [{**CAMERA, **LARGER}]},
}
"""Small worlds and large images, so that an image that is kept is seen after a few worlds."""


def main(folder: str, worlds: int) -> None:
    """Render worlds as a task of Ray does, one after the other."""
    config_json = canonical_json(config_from_mapping(WORLDS))
    allocator = ctypes.CDLL(None)
    found_mb = []
    for world in range(worlds):
        *_, last = render_world(config_json, WorldTask(world, 1000 + world, "train", 2), folder)
        assert isinstance(last, WorldLegend), last
        gc.collect()
        # How much free memory the allocator keeps changes by 30 MB from world to world.
        allocator.malloc_trim(0)
        found_mb.append(resident_bytes() / 1e6)
    sys.stdout.write(json.dumps(found_mb) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
