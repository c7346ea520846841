"""The topics, services and actions of the bridge, one row each; see `interface_table`.

The topics of its sensors are in `sensor_interfaces`.
"""

from __future__ import annotations

from oaisys_ros_bridge.parameters.interface_table import (
    DEFAULT,
    LATCHED,
    LATCHED_HISTORY,
    MOTION,
    SENSOR,
    SMALL_MESSAGES,
    Interface,
    InterfaceKind,
    ground_map_interfaces,
)
from oaisys_ros_bridge.parameters.sensor_interfaces import SENSOR_INTERFACES

_RIG = (
    *ground_map_interfaces("ground_truth/", "as it is"),
    Interface(
        InterfaceKind.PUBLISHED,
        "ground_truth/odometry",
        "nav_msgs/msg/Odometry",
        "The rig's true pose in the map frame, metres, from its start pose on, repeated as /tf; "
        "during drives with its twist, else twist unknown (variances of 1e6): it jumps.",
        MOTION,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "fix",
        "sensor_msgs/msg/NavSatFix",
        "True place of the rig at a sample, on a stage from an elevation model that lies on Earth "
        "(docs/places.md); altitude is the model's elevation.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "pressure",
        "sensor_msgs/msg/FluidPressure",
        "Pressure of standard air (ISO 2533) at the altitude of fix, with which it is published.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "magnetic_field",
        "sensor_msgs/msg/MagneticField",
        "Earth's field in the rig's frame, tesla, without errors (`magnetic_year`), where fix is.",
        SENSOR,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "odometry",
        "nav_msgs/msg/Odometry",
        "The estimated pose of the rig: in the odom frame, with covariance, if it drifts "
        "(`faults.drift_*`, during drives the configuration's `drive`); else the true pose in the "
        "map frame. Start pose, repeats and twist as in ground_truth/odometry.",
        MOTION,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "path",
        "nav_msgs/msg/Path",
        "The rig's poses so far in this world.",
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
        "map to base_link, or map to odom to base_link, of the start pose, of each sample, and at "
        "each time of a drive; the last one repeated at `tf_rate`.",
        MOTION,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        "base_link to camera_link to camera_optical_frame, lidar_link, imu_link, of each sensor; "
        "earth to map on a stage that lies on Earth.",
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
        "Last message of a complete sample: seed, configuration, poses, K, topics, render time.",
        SMALL_MESSAGES,
    ),
    Interface(
        InterfaceKind.PUBLISHED,
        "~/batch",
        "oaisys_msgs/msg/SampleInfo",
        "The current world.",
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
        "Whether a view can be requested: launch files wait for it.",
        LATCHED,
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "~/receipts",
        "oaisys_msgs/msg/SampleReceipt",
        "Up to which sample the mapper and recorders are done: `readers.when_behind`.",
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
        "State, restarts, queue, memory, drops; durations of rendering, transfer and publishing of "
        "the last sample; progress and losses of our own readers. Names begin with the node's "
        "full name. At 1 Hz, at each change, after each sample.",
        DEFAULT,
    ),
)

_REQUESTS = (
    Interface(
        InterfaceKind.SERVICE,
        "~/set_pose",
        "oaisys_msgs/srv/SetPose",
        "Render from a pose of the rig or of a sensor, see Frames; answers after publishing.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/step_batch",
        "oaisys_msgs/srv/StepBatch",
        "Build a new world, from a seed or the next one.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/set_metadata",
        "oaisys_msgs/srv/SetMetadata",
        "Set light, objects, lenses, quality from the next sample on. What it refuses, or cannot "
        "be rendered with, is dropped, and the answer says so. More than a request can hold, or "
        "nested more than 20 times, is refused at once.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/get_newest_sample",
        "oaisys_msgs/srv/GetNewestSample",
        "Which sample `~/sample_info` has announced last, and which world `~/batch`: mapper and "
        "recorder wait for these before they save, evaluate, clear or end.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/query_height",
        "oaisys_msgs/srv/QueryHeight",
        "Heights of ground and surface under points, and the points' clearance.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/get_ground_truth_mesh",
        "oaisys_msgs/srv/GetGroundTruthMesh",
        "The true surface of the world, in the answer or as a file.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/to_lon_lat",
        "oaisys_msgs/srv/ToLonLat",
        "Longitudes, latitudes and elevations of points, on a stage that lies on a body.",
    ),
    Interface(
        InterfaceKind.SERVICE,
        "~/from_lon_lat",
        "oaisys_msgs/srv/FromLonLat",
        "Points of longitudes, latitudes and elevations, or on the ground there.",
    ),
    Interface(
        InterfaceKind.SERVICE, "~/end_simulation", "std_srvs/srv/Trigger", "End the simulator."
    ),
    Interface(
        InterfaceKind.ACTION,
        "~/sweep",
        "oaisys_msgs/action/Sweep",
        "Render from many poses in turn, with feedback; other requests come in between.",
    ),
    Interface(
        InterfaceKind.ACTION,
        "~/drive",
        "oaisys_msgs/action/Drive",
        "Drive along a trajectory in simulated time, each sensor at its rate; other requests wait.",
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "command/pose",
        "geometry_msgs/msg/PoseStamped",
        "Render from there; the newest command wins.",
        "reliable, depth 1",
    ),
    Interface(
        InterfaceKind.SUBSCRIBED,
        "command/trajectory",
        "trajectory_msgs/msg/MultiDOFJointTrajectory",
        "Render from every point, or from the last: `trajectory_points`.",
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
        ("get_simulator_features", "Which features of simulation_interfaces are supported."),
        ("get_entities", "Names of rig, sensors, objects."),
        ("get_entities_states", "Poses of all entities that match."),
        ("get_entity_info", "What an entity is."),
        ("get_entity_state", "Pose of an entity, metres in the map frame."),
        ("set_entity_state", "Move an entity with the next sample; the rig: render from there."),
        ("spawn_entity", "Add a shape, a configured prototype or a mesh file, see Entities."),
        ("delete_entity", "Delete an entity from the next sample on; rig and sensors stay."),
        ("get_simulation_state", "Playing, paused, stopped."),
        ("set_simulation_state", "Play, pause, stop."),
        ("step_simulation", "Render some samples, without feedback."),
        ("reset_simulation", "Reset time, poses or everything."),
        ("load_world", "Load the world of another seed."),
        ("get_available_worlds", "Which worlds there are."),
        ("get_current_world", "The current world."),
    )
)

_SIMULATION_ACTION = Interface(
    InterfaceKind.ACTION,
    "~/simulate_steps",
    "simulation_interfaces/action/SimulateSteps",
    "Render some samples, with feedback.",
)

BRIDGE_INTERFACES = (
    *_REQUESTS,
    *SENSOR_INTERFACES,
    *_RIG,
    *_STATE,
    *_LIFECYCLE,
    *_SIMULATION_SERVICES,
    _SIMULATION_ACTION,
)
