"""Names, variants and encodings of the topics of a sensor.

Encodings: colour and albedo ``rgb8``; depth and range ``32FC1``, metres; labels ``16UC1``; ids
``32SC1``; normals ``32FC3``, unit vectors x, y, z in the optical frame, 0 where nothing was hit;
flow ``32FC2`` and disparity ``32FC1``, pixels; the images of installed passes by their own pixels'
type, such as ``8UC1``.
"""

from __future__ import annotations

from collections.abc import Sequence

from oaisys_core.types import (
    ALBEDO,
    DEPTH,
    DIGITAL,
    DISPARITY,
    DISTANCES,
    FLOW,
    INSTANCE,
    NORMAL,
    RADIANCE,
    RGB,
    Frame,
    semantic_level,
)
from oaisys_ros_bridge.conversions import (
    opencv_encoding,
)
from oaisys_ros_bridge.publishing.compressed import (
    COLORS,
    IDS,
    LABELS,
)

TOPIC_BY_MODALITY = {RGB: "color", DEPTH: "depth"}
"""Topic names of modalities whose topic has another name."""

ENCODING_BY_MODALITY = {
    RGB: "rgb8",
    **dict.fromkeys(sorted(DISTANCES), "32FC1"),
    INSTANCE: "32SC1",
    NORMAL: "32FC3",
    FLOW: "32FC2",
    ALBEDO: "rgb8",
    DISPARITY: "32FC1",
    RADIANCE: "32FC3",
    **{each: each for each in DIGITAL},
}

COMPRESSED, COMPRESSED_DEPTH = "compressed", "compressedDepth"
"""Names of the compressed variants in image_transport."""


def sensor_namespace(sensor: str, sensors: Sequence[object], only: str = "camera") -> str:
    """Return the prefix of a sensor's topics and frames: ``only`` for the only one of its kind."""
    return sensor if len(sensors) > 1 else only


def image_topic(namespace: str, modality: str, name: str) -> str:
    """Return a topic of a camera's images, such as ``camera/color/image_raw``."""
    return f"{namespace}/{TOPIC_BY_MODALITY.get(modality, modality)}/{name}"


def encoding_of(frame: Frame) -> str:
    """Return the image encoding that a frame is published in."""
    if semantic_level(frame.modality) is not None:
        return "16UC1"
    return ENCODING_BY_MODALITY.get(frame.modality) or opencv_encoding(frame.data)


def has_colors(modality: str) -> bool:
    """Return whether a modality's ids are also published as colours."""
    return modality == INSTANCE or semantic_level(modality) is not None


def topic_variants(modality: str) -> tuple[str, ...]:
    """Return the names of a modality's compressed topics.

    Depths and ranges have two topics with the same messages: the name of image_transport, and the
    name that all images have.
    """
    encoding = ENCODING_BY_MODALITY.get(modality, "")
    if modality in DISTANCES:
        return (COMPRESSED, COMPRESSED_DEPTH)
    if encoding in COLORS | IDS | LABELS or semantic_level(modality) is not None:
        return (COMPRESSED,)
    return ()
