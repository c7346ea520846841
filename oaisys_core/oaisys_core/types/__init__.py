"""Plain typed data that crosses package borders: poses, cameras, frames, samples, meshes.

Nothing here knows Blender, gRPC or ROS. Arrays are numpy; units and frames are in the names.
"""

from __future__ import annotations

from oaisys_core.types.arrays import Extent, FloatArray, ShortRepr
from oaisys_core.types.cameras import EQUIDISTANT, MAX_IMAGE_PX, PLUMB_BOB, PinholeIntrinsics
from oaisys_core.types.drives import (
    ODOMETRY,
    DriveInstant,
    DriveOutline,
    ImuReading,
    PlannedTrajectory,
)
from oaisys_core.types.georeference import Georeference
from oaisys_core.types.heights import HeightGrid, HeightQuery
from oaisys_core.types.meshes import TriangleMesh, merge_meshes
from oaisys_core.types.metadata import OWN_PARTS, ModuleMetadata, merge
from oaisys_core.types.modalities import (
    ALBEDO,
    BAYER,
    COLORS,
    DEPTH,
    DEPTH_TRUE,
    DIGITAL,
    DISPARITY,
    DISTANCES,
    FLOW,
    INSTANCE,
    LIT,
    MONO16,
    NORMAL,
    POINTS,
    RADIANCE,
    RANGE,
    RANGE_TRUE,
    RENDERED,
    RGB,
    RGB16,
    SEMANTIC_0,
    ModalitySpec,
    is_rendered,
    modality_expectation,
    modality_spec,
    semantic_level,
)
from oaisys_core.types.objects import MAX_OBJECTS, ObjectPage, ObjectQuery, SceneObject
from oaisys_core.types.poses import Odometry, Pose, TimedPoses, Twist
from oaisys_core.types.progress import Progress, ProgressCallback, ignore_progress
from oaisys_core.types.samples import (
    Frame,
    FrameName,
    Provenance,
    RecordedSample,
    Sample,
    SampleOutline,
    early_first,
)
from oaisys_core.types.scans import LidarScan, point_dtype
from oaisys_core.types.simulator import GroupCount, ImuInfo, LidarInfo, SensorInfo, SimulatorInfo

__all__ = [
    "ALBEDO",
    "BAYER",
    "COLORS",
    "DEPTH",
    "DEPTH_TRUE",
    "DIGITAL",
    "DISPARITY",
    "DISTANCES",
    "EQUIDISTANT",
    "FLOW",
    "INSTANCE",
    "LIT",
    "MAX_IMAGE_PX",
    "MAX_OBJECTS",
    "MONO16",
    "NORMAL",
    "ODOMETRY",
    "OWN_PARTS",
    "PLUMB_BOB",
    "POINTS",
    "RADIANCE",
    "RANGE",
    "RANGE_TRUE",
    "RENDERED",
    "RGB",
    "RGB16",
    "SEMANTIC_0",
    "DriveInstant",
    "DriveOutline",
    "Extent",
    "FloatArray",
    "Frame",
    "FrameName",
    "Georeference",
    "GroupCount",
    "HeightGrid",
    "HeightQuery",
    "ImuInfo",
    "ImuReading",
    "LidarInfo",
    "LidarScan",
    "ModalitySpec",
    "ModuleMetadata",
    "ObjectPage",
    "ObjectQuery",
    "Odometry",
    "PinholeIntrinsics",
    "PlannedTrajectory",
    "Pose",
    "Progress",
    "ProgressCallback",
    "Provenance",
    "RecordedSample",
    "Sample",
    "SampleOutline",
    "SceneObject",
    "SensorInfo",
    "ShortRepr",
    "SimulatorInfo",
    "TimedPoses",
    "TriangleMesh",
    "Twist",
    "early_first",
    "ignore_progress",
    "is_rendered",
    "merge",
    "merge_meshes",
    "modality_expectation",
    "modality_spec",
    "point_dtype",
    "semantic_level",
]
