"""The simulator's core: what a world is, how it is drawn from a seed, and how it is rendered."""

import sys
from pathlib import Path

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:  # as in `python -m oaisys_core`
    del sys.path[0]  # the current folder, whose files nothing may import

from oaisys_core.private.open3d_import import guard_open3d
from oaisys_core.private.scipy_import import guard_scipy

guard_open3d()
guard_scipy()

__version__ = Path(__file__).with_name("VERSION").read_text(encoding="ascii").strip()
