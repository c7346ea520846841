"""The typed configuration: the only place of defaults and of checks of values."""

from oaisys_core.config.adjusting import adjust
from oaisys_core.config.loading import (
    canonical_json,
    config_from_mapping,
    config_sha256,
    load_config,
)
from oaisys_core.config.model import SimulationConfig
from oaisys_core.config.sections.assets import AssetsConfig, PrimitiveConfig, RockGroupConfig
from oaisys_core.config.sections.environment import EnvironmentConfig
from oaisys_core.config.sections.layers import LayerConfig
from oaisys_core.config.sections.materials import MaskConfig, MaterialsConfig
from oaisys_core.config.sections.render import RenderConfig
from oaisys_core.config.sections.sensing.cameras import CameraConfig, LensConfig, StereoConfig
from oaisys_core.config.sections.sensing.sensors import SensorsConfig
from oaisys_core.config.sections.stage import StageConfig

__all__ = [
    "AssetsConfig",
    "CameraConfig",
    "EnvironmentConfig",
    "LayerConfig",
    "LensConfig",
    "MaskConfig",
    "MaterialsConfig",
    "PrimitiveConfig",
    "RenderConfig",
    "RockGroupConfig",
    "SensorsConfig",
    "SimulationConfig",
    "StageConfig",
    "StereoConfig",
    "adjust",
    "canonical_json",
    "config_from_mapping",
    "config_sha256",
    "load_config",
]
