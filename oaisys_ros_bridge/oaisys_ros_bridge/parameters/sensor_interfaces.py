"""The topics of the sensors, one row each; see `interface_table`."""

from __future__ import annotations

from oaisys_ros_bridge.parameters.interface_table import (
    LATCHED,
    MOTION,
    SENSOR,
    Interface,
    InterfaceKind,
)


def _image(name: str, encoding: str) -> tuple[Interface, ...]:
    """Return an image's topics."""
    base = f"camera/{name}/image_raw"
    published = InterfaceKind.PUBLISHED
    image, camera = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
    png = "The compressed image, made only for subscribers; lossless, except colour as JPEG."
    return (
        Interface(published, base, image, encoding, SENSOR),
        Interface(
            published,
            f"camera/{name}/camera_info",
            camera,
            "Its camera: size, K, D, R, P, in pixels; (0, 0) is the first pixel's centre.",
            SENSOR,
        ),
        Interface(published, f"{base}/compressed", "sensor_msgs/msg/CompressedImage", png, SENSOR),
    )


_IMAGES = (
    *_image("color", "`rgb8`."),
    *_image("depth", "`32FC1`, metres along the optical axis; +inf where nothing was hit."),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/depth/image_raw/compressedDepth",
        "sensor_msgs/msg/CompressedImage",
        "As compressed_depth_image_transport writes it; the error bound follows `compressed.*`.",
        SENSOR,
    ),
    *_image("semantic_N", "`16UC1`, ids of level N; 0 is unlabelled."),
    *_image("instance", "`32SC1`, ids of objects; 0 is none."),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/semantic_N/image_color",
        "sensor_msgs/msg/Image",
        "`rgb8`, for viewers: a colour for each label, that of its class in the mapper's mesh; "
        "made only for subscribers.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/instance/image_color",
        "sensor_msgs/msg/Image",
        "`rgb8`, for viewers: a colour for each id, by its hash; black is none. Made only for "
        "subscribers.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/semantic_N/labels",
        "oaisys_msgs/msg/SemanticLabels",
        "Names of the ids.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/semantic_N/label_info",
        "vision_msgs/msg/LabelInfo",
        "The same names, for programs that read vision_msgs.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/detections",
        "vision_msgs/msg/Detection2DArray",
        "Boxes of what is visible of objects; `id` is the object's, `class_id` that of most of its "
        "pixels in `semantic_0`. Only with `instance`.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/detections_3d",
        "vision_msgs/msg/Detection3DArray",
        "Boxes in space of the objects that the image shows, along their own axes, in the optical "
        "frame; the pose of a result is that of the object's origin. Not in drives.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/transform",
        "geometry_msgs/msg/TransformStamped",
        "From `map` to the optical frame, once a sample, for mappers such as voxblox.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/depth_registered/points",
        "sensor_msgs/msg/PointCloud2",
        "x y z in metres, rgb; organised, in the optical frame. `cloud.*` thins it out.",
        SENSOR,
    ),
)

_LIDARS = (
    Interface(
        InterfaceKind.PUBLISHED,
        "lidar/points",
        "sensor_msgs/msg/PointCloud2",
        "x y z intensity `FLOAT32`, ring `UINT16`, time `FLOAT32` (s since the stamp), where "
        "configured label `UINT16`, instance `UINT32`; frame `lidar_link`. Only with a lidar.",
        SENSOR,
    ),
)

_IMUS = (
    Interface(
        InterfaceKind.PUBLISHED,
        "imu/data_raw",
        "sensor_msgs/msg/Imu",
        "Angular rate rad/s, specific force m/s^2; orientation unknown (covariance -1); frame "
        "`imu_link`. Only with an IMU, during drives.",
        MOTION,
    ),
)

SENSOR_INTERFACES = (*_IMAGES, *_LIDARS, *_IMUS)
