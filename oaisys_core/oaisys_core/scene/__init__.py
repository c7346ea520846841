"""The scene of a batch: plain typed data that modules draw and backends build.

All coordinates are in ``map`` (metres, z up).
"""

from __future__ import annotations

from oaisys_core.scene.description import Scene, stands_on
from oaisys_core.scene.ground import Ground, HeightField
from oaisys_core.scene.lamps import Lamp
from oaisys_core.scene.objects import (
    MeshMaterial,
    MeshPrototype,
    Placement,
    Primitive,
    WaterSurface,
    WheelTracks,
    Wrap,
)
from oaisys_core.scene.placed_sensors import (
    Lens,
    LidarErrors,
    PlacedCamera,
    PlacedLidar,
    PoseAtTime,
    ScanPattern,
)
from oaisys_core.scene.sky import Sky
from oaisys_core.scene.surroundings import (
    FarGround,
    LandDetail,
    LandMasks,
    MacroVariation,
    ReliefBand,
)
from oaisys_core.scene.terrain_material import PbrMaps, TerrainLayer, TerrainMaterial, id_of_level

__all__ = [
    "FarGround",
    "Ground",
    "HeightField",
    "Lamp",
    "LandDetail",
    "LandMasks",
    "Lens",
    "LidarErrors",
    "MacroVariation",
    "MeshMaterial",
    "MeshPrototype",
    "PbrMaps",
    "PlacedCamera",
    "PlacedLidar",
    "Placement",
    "PoseAtTime",
    "Primitive",
    "ReliefBand",
    "ScanPattern",
    "Scene",
    "Sky",
    "TerrainLayer",
    "TerrainMaterial",
    "WaterSurface",
    "WheelTracks",
    "Wrap",
    "id_of_level",
    "stands_on",
]
