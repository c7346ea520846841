"""A survey and its verdict from Python: what `oaisys survey` does, called as a function.

    python examples/06_survey.py [WORLD.yaml]

`run_survey` starts server, bridge, mapper and recorder as processes of their own. It looks down
from a grid of viewpoints through the ROS service. Then it measures the rebuilt surface against the
true one. The folder gets report.html, report.json, mesh.ply and certificate.json
(docs/certificate.md).
"""

import argparse
import json
import sys
from pathlib import Path

from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.survey.plan import SurveyOptions
from oaisys_ros_bridge.experiments.survey.survey import run_survey

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("world", nargs="?", type=Path, help="the default: that of `make demo`")
options = SurveyOptions(
    out=Path("out/survey_from_python"),
    config=parser.parse_args().world,
    overrides={"backend": "analytic", "size": "320x240"},  # without Blender
    voxel_size_m=0.1,
    max_range_m=60.0,
    record=False,  # True: all topics as a rosbag2 in bag/
    worker_python=None,
    command=sys.argv,
    views=6,
    altitude_m=7.0,
    overlap=0.35,
    faults=False,  # True: also shows how maps with deliberate faults are rejected
)
passed = run_survey(options, Reporter())

report = json.loads((options.out / "report.json").read_text())
for figure in ("rmse_m", "offset_m", "completion_ratio", "f_score", "hole_ratio"):
    print(f"{figure}: {report[figure]:.4f}")
print("verdict:", "the map agrees with the world" if passed else report["missed"])
sys.exit(0 if passed else 1)
