"""The topics, services and actions of the bridge, one row each; see `interface_table`."""

from __future__ import annotations

from oaisys_ros_bridge.parameters.interface_table import (
    DEFAULT,
    LATCHED,
    LATCHED_HISTORY,
    SENSOR,
    SMALL_MESSAGES,
    Interface,
    InterfaceKind,
)


def _image(name: str, encoding: str) -> tuple[Interface, ...]:
    """Return an image's topics."""
    base = f"camera/{name}/image_raw"
    published = InterfaceKind.PUBLISHED
    image, camera = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
    png = "A file of it, only while somebody listens; exact, but for colour as JPEG."
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
        "camera/semantic_N/labels",
        "oaisys_msgs/msg/SemanticLabels",
        "Names of the ids.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "camera/depth_registered/points",
        "sensor_msgs/msg/PointCloud2",
        "x y z in metres, rgb; organised, in the optical frame. `cloud.*` thins it out.",
        SENSOR,
    ),
)

_RIG = (
    Interface(
        InterfaceKind.PUBLISHED,
        "ground_truth/odometry",
        "nav_msgs/msg/Odometry",
        "The rig's true pose in the map frame, metres; twist unknown (variances of 1e6): it jumps.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "odometry",
        "nav_msgs/msg/Odometry",
        "Where the rig believes to be: drifts as `faults.drift_*` say, with covariance, then in "
        "the odom frame; else the true pose in the map frame. Twist unknown.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "path",
        "nav_msgs/msg/Path",
        "The way so far in this world.",
        "reliable, latched, depth 10",
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "viewpoints",
        "visualization_msgs/msg/MarkerArray",
        "A frustum for each view in this world.",
        "reliable, latched",
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "/tf",
        "tf2_msgs/msg/TFMessage",
        "map to base_link, or map to odom to base_link, of each sample; the last one repeated at "
        "`tf_rate`.",
        "reliable, depth 100",
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        "base_link to camera_link to camera_optical_frame, of each camera.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "/clock",
        "rosgraph_msgs/msg/Clock",
        "Simulated time, only with `publish_clock`: before the first message that carries it.",
        DEFAULT,
    ),
)

_STATE = (
    Interface(
        InterfaceKind.PUBLISHED,
        "~/sample_info",
        "oaisys_msgs/msg/SampleInfo",
        "Last of a sample: it is complete. Seed, configuration, poses, K, topics, render time.",
        SMALL_MESSAGES,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/batch",
        "oaisys_msgs/msg/SampleInfo",
        "The world that stands.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/configuration",
        "std_msgs/msg/String",
        "The simulator's whole configuration as JSON, whose hash `~/sample_info` names.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/ready",
        "std_msgs/msg/Bool",
        "Whether a view can be asked for: launch files wait for it.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "~/receipts",
        "oaisys_msgs/msg/SampleReceipt",
        "How far the mapper and recorders are: `readers.when_behind`.",
        LATCHED_HISTORY,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/transition_event",
        "lifecycle_msgs/msg/TransitionEvent",
        "Of the managed node.",
        DEFAULT,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "/diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        "State, restarts, queue, memory, drops; what rendering, transfer and publishing of the "
        "last sample took; how far our own readers are and what they have lost. At 1 Hz, at each "
        "change, after each sample.",
        DEFAULT,
    ),
)

_REQUESTS = (
    Interface(
        InterfaceKind.SERVICE,
        "~/set_pose",
        "oaisys_msgs/srv/SetPose",
        "Look from a pose in the map frame, of the rig or of a sensor; answers after publishing.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/step_batch",
        "oaisys_msgs/srv/StepBatch",
        "A new world, from a seed or the next one.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/set_metadata",
        "oaisys_msgs/srv/SetMetadata",
        "Light, objects, lenses, quality from the next sample on.",
    ),
    Interface(
        InterfaceKind.SERVICE, "~/end_simulation", "std_srvs/srv/Trigger", "End the simulator."
    ),
    Interface(
        InterfaceKind.ACTION,
        "~/sweep",
        "oaisys_msgs/action/Sweep",
        "Look from many poses in turn, with feedback; others' requests come in between.",
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "command/pose",
        "geometry_msgs/msg/PoseStamped",
        "Look from there; the newest wins.",
        "reliable, depth 1",
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "command/trajectory",
        "trajectory_msgs/msg/MultiDOFJointTrajectory",
        "Look from every point, or from the last: `trajectory_points`.",
        "reliable, depth 1",
    ),
)

_LIFECYCLE = tuple(
    Interface(
        InterfaceKind.SERVICE, f"~/{name}", f"lifecycle_msgs/srv/{kind}", "Of the managed node."
    )
    for name, kind in (
        ("change_state", "ChangeState"),
        ("get_state", "GetState"),
        ("get_available_states", "GetAvailableStates"),
        ("get_available_transitions", "GetAvailableTransitions"),
        ("get_transition_graph", "GetAvailableTransitions"),
    )
)

_SIMULATION_SERVICES = tuple(
    Interface(
        InterfaceKind.SERVICE,
        f"~/{name}",
        f"simulation_interfaces/srv/{''.join(part.title() for part in name.split('_'))}",
        description,
    )
    for name, description in (
        ("get_simulator_features", "What of simulation_interfaces has a meaning here."),
        ("get_entities", "Names of rig, sensors, objects."),
        ("get_entities_states", "Poses of all that match."),
        ("get_entity_info", "What one is."),
        ("get_entity_state", "Where one is, metres in the map frame."),
        ("set_entity_state", "Put one elsewhere with the next sample; the rig: look from there."),
        ("spawn_entity", "Add a shape, a configured thing or a mesh file, see Entities."),
        ("delete_entity", "Take one away from the next sample on; rig and sensors stay."),
        ("get_simulation_state", "Playing, paused, stopped."),
        ("set_simulation_state", "Play, pause, stop."),
        ("step_simulation", "Some samples, without telling on the way."),
        ("reset_simulation", "Time, poses or everything back to the beginning."),
        ("load_world", "Another configuration or seed."),
        ("get_available_worlds", "Which ones there are."),
        ("get_current_world", "Which one stands."),
    )
)

_SIMULATION_ACTION = Interface(
    InterfaceKind.ACTION,
    "~/simulate_steps",
    "simulation_interfaces/action/SimulateSteps",
    "Some samples, with feedback.",
)

BRIDGE_INTERFACES = (
    *_REQUESTS,
    *_IMAGES,
    *_RIG,
    *_STATE,
    *_LIFECYCLE,
    *_SIMULATION_SERVICES,
    _SIMULATION_ACTION,
)
