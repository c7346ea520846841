"""Messages of stereo_msgs and vision_msgs: disparities, names of labels, boxes of objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovariance, Vector3
from numpy.typing import NDArray
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage
from vision_msgs.msg import (
    BoundingBox2D,
    BoundingBox3D,
    Detection2D,
    Detection2DArray,
    Detection3D,
    Detection3DArray,
    LabelInfo,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    Point2D,
    Pose2D,
    VisionClass,
)

from oaisys_core.geometry import invert, pose_from_matrix, pose_to_matrix, transform
from oaisys_core.geometry.pixel_boxes import pixel_boxes
from oaisys_core.types import FloatArray, Frame, SceneObject
from oaisys_ros_bridge.conversions import image_to_msg, pose_to_msg


def disparity_msg(frame: Frame, header: Header, baseline_m: float) -> DisparityImage:
    """Return the disparities of a left image: z is ``f * t / d``; d below the minimum is invalid.

    Args:
        frame: (H, W) float32 disparities in pixels, 0 where nothing was hit.
        header: Of the left camera.
        baseline_m: Of the pair.
    """
    seen = frame.data[frame.data > 0]
    least, most = (float(seen.min()), float(seen.max())) if seen.size else (1.0, 1.0)
    height, width = frame.data.shape
    return DisparityImage(
        header=header,
        image=image_to_msg(frame.data, "32FC1", header),
        f=float(frame.intrinsics.fx_px),
        t=float(baseline_m),
        valid_window=RegionOfInterest(height=height, width=width),
        min_disparity=least,
        max_disparity=most,
        delta_d=float(np.spacing(np.float32(most))),
    )


def label_info_msg(names: Mapping[int, str], header: Header) -> LabelInfo:
    """Return the names of semantic ids."""
    classes = [VisionClass(class_id=i, class_name=name) for i, name in sorted(names.items())]
    return LabelInfo(header=header, class_map=classes, threshold=0.0)


def detections_msg(
    instances: NDArray[Any], labels: NDArray[Any] | None, header: Header
) -> Detection2DArray:
    """Return the boxes of what is visible of objects, by rising id.

    A box covers its pixels entirely; pixel centres are at integers. ``id`` is the object's,
    ``class_id`` the semantic id of most of its pixels, ``score`` 1.

    Args:
        instances: (H, W) ids of objects, 0 for none.
        labels: (H, W) semantic ids; None leaves out the class.
        header: Of the images.
    """
    shown = pixel_boxes(instances)
    if not shown.ids.size:
        return Detection2DArray(header=header)
    classes = None if labels is None else _classes(instances, labels, shown.ids).tolist()
    detections = [
        _detection(instance_id, box_px, None if classes is None else classes[i], header)
        for i, (instance_id, box_px) in enumerate(
            zip(shown.ids.tolist(), shown.boxes_px.tolist(), strict=True)
        )
    ]
    return Detection2DArray(header=header, detections=detections)


def _classes(instances: NDArray[Any], labels: NDArray[Any], ids: NDArray[np.int64]) -> NDArray[Any]:
    """Return the most frequent label of each object, the smaller of two that are as frequent."""
    is_object = instances > 0
    kinds, inverse = np.unique(labels[is_object], return_inverse=True)
    votes = np.zeros((len(ids), len(kinds)), np.int64)
    np.add.at(votes, (np.searchsorted(ids, instances[is_object]), inverse), 1)
    return np.asarray(kinds[votes.argmax(axis=1)])


def _detection(
    instance_id: int, box_px: Sequence[int], class_id: int | None, header: Header
) -> Detection2D:
    left, top, width, height = box_px
    hypotheses = []
    if class_id is not None:
        hypothesis = ObjectHypothesis(class_id=str(class_id), score=1.0)
        hypotheses.append(ObjectHypothesisWithPose(hypothesis=hypothesis))
    centre = Pose2D(position=Point2D(x=left + (width - 1) / 2, y=top + (height - 1) / 2))
    bbox = BoundingBox2D(center=centre, size_x=float(width), size_y=float(height))
    return Detection2D(header=header, results=hypotheses, bbox=bbox, id=str(instance_id))


def boxes_msg(
    objects: Sequence[SceneObject], T_map_camera: FloatArray, header: Header
) -> Detection3DArray:
    """Return the boxes of objects along their own axes, by rising id.

    ``id`` is the object's, ``class_id`` its semantic id, ``score`` 1, and the pose of the result
    that of the object's own origin: the centre of its base, or of a solid its centre.

    Args:
        objects: The objects.
        T_map_camera: (4, 4) pose of the frame that the boxes are in.
        header: Of that frame.
    """
    T_camera_map = invert(T_map_camera)
    ordered = sorted(objects, key=lambda each: each.instance_id)
    return Detection3DArray(
        header=header, detections=[_box(each, T_camera_map, header) for each in ordered]
    )


def _box(thing: SceneObject, T_camera_map: FloatArray, header: Header) -> Detection3D:
    low_m, high_m = np.array(thing.box_low_m), np.array(thing.box_high_m)
    T_camera_object = T_camera_map @ pose_to_matrix(thing.pose)
    T_camera_box = T_camera_object @ transform(np.eye(3), (low_m + high_m) / 2)
    x_m, y_m, z_m = (high_m - low_m).tolist()
    hypothesis = ObjectHypothesisWithPose(
        hypothesis=ObjectHypothesis(class_id=str(thing.semantic_id), score=1.0),
        pose=PoseWithCovariance(pose=pose_to_msg(pose_from_matrix(T_camera_object))),
    )
    box = BoundingBox3D(
        center=pose_to_msg(pose_from_matrix(T_camera_box)), size=Vector3(x=x_m, y=y_m, z=z_m)
    )
    return Detection3D(header=header, results=[hypothesis], bbox=box, id=str(thing.instance_id))
