"""One typed configuration: each default stands here once, each value is checked once."""

from oaisys_core.config.adjusting import adjusted
from oaisys_core.config.loading import config_from_mapping, config_sha256, load_config
from oaisys_core.config.model import (
    AssetsConfig,
    EnvironmentConfig,
    LayerConfig,
    MaskConfig,
    MaterialsConfig,
    PrimitiveConfig,
    RenderConfig,
    RockGroupConfig,
    SimulationConfig,
    StageConfig,
)
from oaisys_core.config.sensors import CameraConfig, SensorsConfig

__all__ = [
    "AssetsConfig",
    "CameraConfig",
    "EnvironmentConfig",
    "LayerConfig",
    "MaskConfig",
    "MaterialsConfig",
    "PrimitiveConfig",
    "RenderConfig",
    "RockGroupConfig",
    "SensorsConfig",
    "SimulationConfig",
    "StageConfig",
    "adjusted",
    "config_from_mapping",
    "config_sha256",
    "load_config",
]
