"""The built-in modules, one per aspect of the world; none of them depends on Blender."""

from oaisys_core.world.modules.assets.module import AssetsModule
from oaisys_core.world.modules.environment import EnvironmentModule
from oaisys_core.world.modules.materials import MaterialsModule
from oaisys_core.world.modules.render import RenderModule
from oaisys_core.world.modules.sensors import SensorsModule
from oaisys_core.world.modules.stage import StageModule

__all__ = [
    "AssetsModule",
    "EnvironmentModule",
    "MaterialsModule",
    "RenderModule",
    "SensorsModule",
    "StageModule",
]
