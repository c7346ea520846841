"""What a worker holds after each of many worlds: ``python worker_memory.py FOLDER WORLDS``.

Prints the resident memory after each world, in MB, as JSON. The worlds are written to FOLDER.
"""

from __future__ import annotations

import json
import sys

from endurance import resident_bytes
from small_datasets import SCANNED

from oaisys_core.config import canonical_json, config_from_mapping
from oaisys_core.dataset.manifest import WorldLegend
from oaisys_core.dataset.plan import WorldTask
from oaisys_core.dataset.workers import render_world


def main(folder: str, worlds: int) -> None:
    """Render worlds as a task of Ray does, one after the other."""
    config_json = canonical_json(config_from_mapping(SCANNED))
    found_mb = []
    for world in range(worlds):
        *_, last = render_world(config_json, WorldTask(world, 1000 + world, "train", 2), folder)
        assert isinstance(last, WorldLegend), last
        found_mb.append(resident_bytes() / 1e6)
    sys.stdout.write(json.dumps(found_mb) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
