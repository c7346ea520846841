"""Repeats the perturbation test of a survey from its recorded bag alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.certificate.certificate import CERTIFICATE_FILE, read_certificate
from oaisys_mapping.certificate.perturbations import PerturbationResult, PosedDepth
from oaisys_mapping.certificate.verification import measurement_setup
from oaisys_mapping.evaluation.thresholds import survey_thresholds
from oaisys_mapping.evaluation.true_surface import true_surface
from oaisys_mapping.evaluation.truth_io import read_truth
from oaisys_mapping.tsdf import TsdfConfig
from oaisys_ros_bridge.bags.reading import BagReader
from oaisys_ros_bridge.experiments.configuration import TRUTH_FILE
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import run_perturbations
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.namespaces import TF, TF_STATIC
from oaisys_ros_bridge.subscribing.frame_assembly import FrameAssembler

MAP_FRAME = "map"
DEPTH_TOPIC = "/depth/image_raw"


def perturb_bag(folder: Path, reporter: Reporter) -> list[PerturbationResult]:
    """Return the verdicts on maps of a survey's recorded frames, without and with each fault.

    Args:
        folder: Of the survey, with its certificate, its truth and its bag.
        reporter: Says the verdict on each map.

    Raises:
        InvalidInputError: One of them is missing, or the certificate does not say how to measure.
    """
    setup = measurement_setup(read_certificate(folder / CERTIFICATE_FILE)["content"])
    frames = list(frames_of_bag(folder / "bag"))
    if not frames:
        raise InvalidInputError("bag", str(folder / "bag"), "a bag with depth images and poses")
    reporter.say(f"{len(frames)} frames in the bag")
    surface = true_surface(
        read_truth(folder / TRUTH_FILE),
        setup.views,
        setup.voxel_size_m,
        setup.max_range_m,
        setup.rng(),
    )
    config = TsdfConfig(voxel_size_m=setup.voxel_size_m, max_range_m=setup.max_range_m)
    thresholds = survey_thresholds(setup.voxel_size_m)
    return run_perturbations(frames, surface, thresholds, config, setup.seed, reporter)


def frames_of_bag(bag: Path) -> Iterator[PosedDepth]:
    """Yield the depth images of a bag's first camera with the poses that its transforms give.

    Raises:
        InvalidInputError: There is no bag, or a message in it cannot be used.
    """
    assembler = FrameAssembler(MAP_FRAME, use_color=False)
    reader = BagReader(bag)
    depth = min((topic for topic in reader.topics if topic.endswith(DEPTH_TOPIC)), default="")
    if not depth:
        return
    handlers = _handlers(assembler, depth, reader.topics)
    for message in reader.messages(handlers.keys()):
        message_type, handle = handlers[message.topic]
        handle(message.deserialize(message_type))
        while (frame := assembler.pop()) is not None:
            yield PosedDepth(frame.depth_m, frame.intrinsics, frame.T_map_camera)


def _handlers(
    assembler: FrameAssembler, depth: str, topics: Iterable[str]
) -> dict[str, tuple[type[Any], Callable[[Any], None]]]:
    """Return the type and the handler of the messages of each topic that is needed."""
    handlers: dict[str, tuple[type[Any], Callable[[Any], None]]] = {
        depth: (Image, lambda message: assembler.add_image("depth", message, 0.0)),
        depth.replace("image_raw", "camera_info"): (
            CameraInfo,
            lambda message: assembler.add_image("info", message, 0.0),
        ),
    }
    for topic in topics:
        if topic.endswith(TF_STATIC):
            handlers[topic] = (TFMessage, assembler.add_static)
        elif topic.endswith(TF):
            handlers[topic] = (TFMessage, assembler.add_transforms)
    return handlers
