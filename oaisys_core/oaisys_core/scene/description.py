"""The scene of a batch: plain typed data that modules draw and backends build.

All coordinates are in ``map`` (metres, z up).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from oaisys_core.scene.ground import Ground
from oaisys_core.scene.lamps import Lamp
from oaisys_core.scene.objects import MeshPrototype, Placement, Primitive, WheelTracks
from oaisys_core.scene.sky import Sky
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.scene.terrain_material import TerrainMaterial


@dataclass(frozen=True)
class Scene:
    """The world of a batch.

    Attributes:
        stage_hash: Content hash of the ground, by which a backend sees that it did not change.
        semantic_labels: The name of each semantic id in the scene.
        lamps: The lamps that are on, in ``map``.
        tracks: Of rovers that drive on the ground.
        far_ground: The ground beyond the stage, if the sky shows it; it is no part of the ground
            truth mesh.
    """

    ground: Ground
    material: TerrainMaterial
    prototypes: tuple[MeshPrototype, ...]
    placements: tuple[Placement, ...]
    primitives: tuple[Primitive, ...]
    sky: Sky
    semantic_labels: Mapping[int, str]
    stage_hash: str = ""
    custom: Mapping[str, Any] = field(default_factory=dict)
    lamps: tuple[Lamp, ...] = ()
    far_ground: FarGround | None = None
    tracks: tuple[WheelTracks, ...] = ()

    def differs_from(self, other: Scene) -> bool:
        """Return whether a part is a different object, or the light or a label differs."""
        kept = (
            self.ground is other.ground
            and self.far_ground is other.far_ground
            and self.material is other.material
            and self.prototypes is other.prototypes
            and self.placements is other.placements
            and self.primitives is other.primitives
            and self.tracks is other.tracks
        )
        same_light = self.sky == other.sky and self.lamps == other.lamps
        return not (kept and same_light and self.semantic_labels == other.semantic_labels)


def stands_on(old: Scene | None, new: Scene) -> bool:
    """Return whether two scenes have the same ground and material."""
    return (
        old is not None
        and bool(new.stage_hash)
        and new.stage_hash == old.stage_hash
        and new.material is old.material
    )
