"""The same over gRPC: worlds and views from a running server, in any process or on any machine.

    oaisys serve                                    # in another shell; prints "ready: ADDRESS"
    python examples/02_over_grpc.py [ADDRESS] [--out out/over_grpc.png]

The client speaks the core's types and raises the core's errors. On one machine pixels come through
shared memory, elsewhere through the connection; the client finds out by itself. `render_sample`
waits for the whole sample; `stream_sample` yields each frame as soon as it is ready, depth and
labels before colour. Another language needs only the proto: see examples/node/.
"""

import argparse
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_looking_at
from oaisys_grpc.client import DEFAULT_ADDRESS, SimulatorClient

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("address", nargs="?", default=DEFAULT_ADDRESS, help="the default: %(default)s")
parser.add_argument("--out", type=Path, default=Path("out/over_grpc.png"), help="a picture")
options = parser.parse_args()
with SimulatorClient(options.address, timeout_s=300) as simulator:
    simulator.step_batch(seed=7)
    camera = simulator.info().sensors[0].name

    sample = simulator.render_sample(pose_looking_at((-8, -6, 6), (0, 0, 0)))
    depth_m = sample.frame(camera, "depth").data
    print(f"sample {sample.sample_id}: median depth {np.median(depth_m):.2f} m")
    print("picture:", sample.save(options.out))

    with simulator.stream_sample(pose_looking_at((8, -6, 6), (0, 0, 0))) as frames:
        for frame in frames:
            print(f"sample {frames.outline.sample_id}: {frame.modality} is here")

    try:
        simulator.render_sample(pose_looking_at((0, 0, -5), (1, 0, -5)))
    except InvalidInputError as error:  # the pose is under the ground
        print(f"refused: {error}")
