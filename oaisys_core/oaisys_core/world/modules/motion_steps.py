"""What a motion of the rig may use of the world that is being drawn."""

from __future__ import annotations

import numpy as np

from oaisys_core import randomness
from oaisys_core.errors import InvalidInputError
from oaisys_core.trajectory.sample_poses.base import STREAM, Motion, MotionStep
from oaisys_core.types import FloatArray
from oaisys_core.world.module import World, require


def motion_step(motion: Motion, world: World, batch_seed: int) -> MotionStep:
    """Return the step of a motion at the sample of the world."""
    index = (world.sample_id - 1) // motion.step_interval
    return MotionStep(
        index=index,
        rng=randomness.stream(batch_seed, STREAM, index + 1),
        batch_rng=randomness.stream(batch_seed, STREAM),
        ground=require(world.ground),
        locate=lambda instance_id: _position_m(world, instance_id),
        georeference=world.georeference,
    )


def _position_m(world: World, instance_id: int) -> FloatArray:
    """Return the (3,) position of an object in ``map``."""
    for primitive in world.primitives:
        if primitive.instance_id == instance_id:
            return np.array(primitive.T_map_object[:3, 3])
    for placement in world.placements:
        (found,) = np.nonzero(placement.instance_ids == instance_id)
        if len(found):
            return np.array(placement.T_map_object[found[0], :3, 3])
    raise InvalidInputError(
        "sensors.motion.target_instance", instance_id, "the instance id of an object in this world"
    )
