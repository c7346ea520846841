"""What the project needs around itself: set-up of a machine without ROS."""

import runpy
import sys
from pathlib import Path

if sys.argv[:1] == ["-m"]:  # as in `python -m tools.gallery`
    # By its path: `tools.setup` runs before our packages are installed.
    _STREAMS = Path(__file__).parents[1] / "oaisys_core/oaisys_core/system/standard_streams.py"
    runpy.run_path(str(_STREAMS))["open_standard_streams"]()
