"""Reads a mesh from a file by Blender: ``python -m oaisys_core.render.blender.blend_program``.

It runs in a separate process, so that the file cannot change the rendered scene or crash the
simulator. It may read the file's own folder and the asset roots, and nothing else but what Python
and Blender consist of.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from pathlib import Path

from oaisys_core.files.access_limits import limit_access, limit_resources
from oaisys_core.system.ending.owner import follow_owner


def main() -> None:
    """Write the arrays of the mesh to a file; arguments as JSON on the command line."""
    follow_owner()
    task = json.loads(sys.argv[1])
    folders = tuple(map(Path, task["folders"]))
    limit_resources(task["memory_bytes"], task["time_s"])
    limit_access(folders, Path(task["out"]).parent)
    import numpy as np

    from oaisys_core.render.blender.objects.blend_files import read_by_blender

    np.savez(task["out"], **read_by_blender(Path(task["file"]), task["object_name"], folders))


if __name__ == "__main__":
    status = 1
    try:
        main()
        status = 0
    except BaseException:  # noqa: BLE001  # whatever it is, the process ends here
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        # Without Blender's own end: with a driver in the file it waits for a lock that nobody holds
        # any more, that of the interpreter.
        os._exit(status)
