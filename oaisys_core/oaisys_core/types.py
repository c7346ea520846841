"""Plain typed data that crosses package borders: poses, cameras, frames, samples, meshes.

Nothing here knows Blender, gRPC or ROS. Arrays are numpy; units and frames are in the names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RGB = "rgb"
DEPTH = "depth"
SEMANTIC_0 = "semantic_0"
INSTANCE = "instance"

MODALITY_DTYPES: Mapping[str, np.dtype[Any]] = {
    RGB: np.dtype(np.uint8),
    DEPTH: np.dtype(np.float32),
    SEMANTIC_0: np.dtype(np.uint16),
    INSTANCE: np.dtype(np.uint32),
}
"""Modalities that every backend renders: ``rgb`` is (H, W, 3), the others are (H, W)."""


@dataclass(frozen=True)
class Pose:
    """Position and orientation of a body frame in ``map`` (REP-103: x forward, y left, z up).

    Attributes:
        position_m: (x, y, z) in metres.
        quat_xyzw: Unit quaternion that rotates body coordinates into ``map``.
    """

    position_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


@dataclass(frozen=True)
class PinholeIntrinsics:
    """Pinhole camera without distortion, in OpenCV's convention: pixel centres at integers.

    Attributes:
        width_px, height_px: Image size.
        fx_px, fy_px: Focal lengths in pixels.
        cx_px, cy_px: Principal point; (319.5, 239.5) is the centre of a 640x480 image.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    @property
    def K(self) -> FloatArray:  # noqa: N802 - the field's name for the camera matrix
        """The 3x3 camera matrix."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )


@dataclass(frozen=True)
class Provenance:
    """What must be known to render a frame again, byte for byte in depth and labels.

    Attributes:
        seed: Root seed of the simulation's random draws.
        batch_seed: Seed that this batch was drawn from.
        config_sha256: Hash of the canonical configuration.
        backend: ``blender`` or ``analytic``.
        backend_version: For instance ``5.2.3``; the package's own version for ``analytic``.
        quality: Name of the quality preset.
        render_samples: Light samples per pixel of the RGB pass (0: none).
    """

    seed: int
    batch_seed: int
    config_sha256: str
    backend: str
    backend_version: str
    quality: str
    render_samples: int


@dataclass(frozen=True)
class Frame:
    """One image of one sensor.

    Attributes:
        sensor: Name of the sensor.
        modality: ``rgb``, ``depth``, ``semantic_0`` ... or ``instance``.
        data: (H, W) or (H, W, 3), dtype by `MODALITY_DTYPES`. Depth is planar z in metres at the
            pixel's centre, ``+inf`` where nothing was hit (REP-117).
        intrinsics: The camera.
        T_map_camera: (4, 4) pose of the camera's *optical* frame (z forward, x right, y down).
    """

    sensor: str
    modality: str
    data: NDArray[Any]
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray


@dataclass(frozen=True)
class Sample:
    """All frames rendered for one rig pose.

    Attributes:
        batch_id, sample_id: Counted from 1; sample ids restart with each batch.
        rig_pose: Pose of the rig (``base_link``) in ``map``.
        frames: One per sensor and modality.
        render_time_s: Wall-clock seconds the backend worked.
        provenance: How to render it again.
    """

    batch_id: int
    sample_id: int
    rig_pose: Pose
    frames: tuple[Frame, ...]
    render_time_s: float
    provenance: Provenance

    def frame(self, sensor: str, modality: str) -> Frame:
        """Return the frame of ``sensor`` and ``modality``; `KeyError` where there is none."""
        for candidate in self.frames:
            if candidate.sensor == sensor and candidate.modality == modality:
                return candidate
        raise KeyError(f"no frame {sensor}/{modality}")


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles in ``map``, with optional ids per triangle.

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32 vertex indices.
        semantic_ids: (T,) uint16 or None.
        instance_ids: (T,) uint32 or None.
    """

    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    semantic_ids: NDArray[np.uint16] | None = None
    instance_ids: NDArray[np.uint32] | None = None


@dataclass(frozen=True)
class SensorInfo:
    """A camera as a client sees it: its name, its intrinsics and where it sits on the rig.

    Attributes:
        T_base_camera: (4, 4) pose of the optical frame in ``base_link``.
        modalities: What it renders.
    """

    name: str
    intrinsics: PinholeIntrinsics
    T_base_camera: FloatArray
    modalities: tuple[str, ...]


@dataclass(frozen=True)
class SimulatorInfo:
    """What a running simulator is and offers.

    Attributes:
        semantic_labels: Name by semantic id.
        stage_extent_m: (min_x, min_y, max_x, max_y) of the ground, or None before the first batch.
    """

    backend: str
    backend_version: str
    seed: int
    config_sha256: str
    quality: str
    sensors: tuple[SensorInfo, ...]
    semantic_labels: Mapping[int, str]
    batch_id: int
    sample_id: int
    stage_extent_m: tuple[float, float, float, float] | None


@dataclass(frozen=True)
class HeightQuery:
    """Heights under points; NaN where a point is off the stage.

    Attributes:
        ground_height_m: (N,) elevation of the ground.
        surface_height_m: (N,) height of the topmost surface, objects included.
        clearance_m: (N,) the point's z minus the surface's height; negative inside the ground.
    """

    ground_height_m: FloatArray
    surface_height_m: FloatArray
    clearance_m: FloatArray


OWN_PARTS = frozenset({"sensor", "environment", "asset", "render"})
"""Parts of `ModuleMetadata` that are fields of their own; all others are in ``custom``."""


@dataclass(frozen=True)
class ModuleMetadata:
    """What a caller sets for one step, by module; an absent part keeps what was.

    Each part is a mapping of that module's own keys; a module refuses keys it does not know.
    ``sensor`` understands ``pose`` (`Pose`).
    """

    sensor: Mapping[str, Any] | None = None
    environment: Mapping[str, Any] | None = None
    asset: Mapping[str, Any] | None = None
    render: Mapping[str, Any] | None = None
    custom: Mapping[str, Any] = field(default_factory=dict)

    def part(self, name: str) -> Mapping[str, Any] | None:
        """Return the part called ``name``, from ``custom`` where it is no field; None if absent."""
        part: Mapping[str, Any] | None
        part = getattr(self, name) if name in OWN_PARTS else self.custom.get(name)
        return part

    def updated(self, later: ModuleMetadata) -> ModuleMetadata:
        """Return what holds after ``later`` was applied on top of this."""
        return ModuleMetadata(
            sensor={**(self.sensor or {}), **(later.sensor or {})},
            environment={**(self.environment or {}), **(later.environment or {})},
            asset={**(self.asset or {}), **(later.asset or {})},
            render={**(self.render or {}), **(later.render or {})},
            custom={**self.custom, **later.custom},
        )


@dataclass(frozen=True)
class Progress:
    """How far an operation is.

    Attributes:
        stage: What it does now, such as ``terrain`` or ``render``.
        fraction: 0 to 1 of the whole operation.
    """

    stage: str
    fraction: float
