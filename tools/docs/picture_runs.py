"""How each tutorial is run for its picture: alone, or with a server, a bridge or a data set."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from oaisys_core.types import sample_pictures
from oaisys_dataset import open_dataset
from tools.programs import ROOT

TIMEOUT_S = 1200.0
SIZE = "320x240"
FRAMES = 4
TOPIC = "/camera/color/image_raw"


def run_with_out(example: Path, folder: Path, *arguments: str) -> Path:
    """Run an example that writes a picture to `--out`, and return the picture."""
    out = folder / "picture.png"
    _run([sys.executable, "-P", str(example), *arguments, "--out", str(out)], folder)
    return out


def run_against_server(example: Path, folder: Path) -> Path:
    """Run the client of a server."""
    with _serving(folder) as address:
        return run_with_out(example, folder, address)


def run_against_bridge(example: Path, folder: Path) -> Path:
    """Run the planner over ROS with a recorder beside it; show the views that were recorded."""
    from sensor_msgs.msg import Image as ImageMsg  # the other tutorials need no ROS

    from oaisys_ros_bridge.bags.reading import BagReader
    from oaisys_ros_bridge.conversions import image_from_msg

    ros = {"ROS_DOMAIN_ID": str(os.getpid() % 100 + 1)}
    with _serving(folder) as address:
        bag = folder / "bag"
        node = ["oaisys_ros_bridge.nodes.bridge", "--ros-args", "-p", f"address:={address}"]
        recorder = ["oaisys_core", "record", "--out", str(bag), "--topic", TOPIC]
        with _program(node, folder, ros), _program(recorder, folder, ros, "recording: "):
            patient = ["--timeout", f"{TIMEOUT_S:g}"]
            _run([sys.executable, "-P", str(example), *patient], folder, ros)
    recorded = BagReader(bag).messages({TOPIC})
    views = [image_from_msg(each.deserialize(ImageMsg)) for each in recorded]
    return _save(np.hstack(views), folder)


def run_survey(example: Path, folder: Path) -> Path:
    """Run the survey and return its picture of the rebuilt mesh."""
    _run([sys.executable, "-P", str(example)], folder)
    return folder / "out" / "survey_from_python" / "pictures" / "mesh_0.jpg"


def run_on_dataset(example: Path, folder: Path) -> Path:
    """Render a small set, train on it, and show some of its frames above their labels."""
    config, dataset = ROOT / "config" / "examples" / "dataset.yaml", folder / "dataset"
    options = ["--worlds", str(FRAMES), "--views", "1", "--splits", "train=1", "--quality", "draft"]
    command = ["dataset", "render", str(config), "--size", SIZE, *options, "--out", str(dataset)]
    _run([sys.executable, "-P", "-m", "oaisys_core", *command], folder)
    _run([sys.executable, "-P", str(example), str(dataset)], folder)
    frames = [each.arrays for each in open_dataset(str(dataset)).split("train")]
    colors = np.hstack([each["rgb"] for each in frames])
    labels = np.hstack([sample_pictures.frame_picture(each["semantic_0"]) for each in frames])
    return _save(np.vstack([colors, labels]), folder)


def _save(picture: NDArray[np.uint8], folder: Path) -> Path:
    path = folder / "picture.png"
    Image.fromarray(picture).save(path)
    return path


def _run(command: Sequence[str], folder: Path, variables: Mapping[str, str] | None = None) -> None:
    environment = os.environ | dict(variables or {})
    subprocess.run(command, cwd=folder, env=environment, check=True, timeout=TIMEOUT_S)


@contextmanager
def _serving(folder: Path) -> Iterator[str]:
    """Serve the default world, and yield the server's address."""
    options = ["serve", "--quality", "draft", "--size", SIZE, "--address", "127.0.0.1:0"]
    with _program(["oaisys_core", *options], folder, {}, "ready: ") as address:
        yield address


@contextmanager
def _program(
    module: Sequence[str], folder: Path, variables: Mapping[str, str], first: str = ""
) -> Iterator[str]:
    """Run a module with its arguments; yield what follows `first` once a line begins with it.

    Raises:
        RuntimeError: The program ended before it printed such a line.
    """
    command = [sys.executable, "-P", "-m", *module]
    environment = os.environ | dict(variables)
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
    ) as program:
        try:
            if not first or program.stdout is None:
                yield ""
                return
            for line in program.stdout:
                if line.startswith(first):
                    break
            else:
                raise RuntimeError(f"{command} ended before it printed {first!r}")
            yield line.removeprefix(first).strip()
        finally:
            program.terminate()
            program.communicate()


RUNS: Mapping[str, Callable[[Path, Path], Path]] = {
    "02_over_grpc": run_against_server,
    "03_planner": run_against_bridge,
    "06_survey": run_survey,
    "07_train_on_a_dataset": run_on_dataset,
}
"""Tutorials that need something beside them, or that leave their picture elsewhere."""
