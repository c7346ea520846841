"""The built-in modules, one per aspect of the world; none of them depends on Blender."""

from oaisys_core.modules.assets.module import AssetsModule
from oaisys_core.modules.environment import EnvironmentModule
from oaisys_core.modules.materials import MaterialsModule
from oaisys_core.modules.render import RenderModule
from oaisys_core.modules.sensors import SensorsModule
from oaisys_core.modules.stage import StageModule

__all__ = [
    "AssetsModule",
    "EnvironmentModule",
    "MaterialsModule",
    "RenderModule",
    "SensorsModule",
    "StageModule",
]
