"""Random small configurations, drawn from the configuration's model, and hashes of their images.

Numbers are drawn near their defaults and within the model's limits, choices from all there are, so
that a new key takes part without a change here. What would be large or need a file stays as it is.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Any, Literal, get_args, get_origin

from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.config.sections.layers import LayerConfig
from oaisys_core.errors import ConfigError
from oaisys_core.procedural.scatter.shapes import SHAPES
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.procedural.textures.library import TEXTURES
from oaisys_core.simulation import Simulation
from oaisys_core.world.module import Module

Json = dict[str, Any]
EXACT = ("depth", "semantic_0", "semantic_1", "instance")
"""Modalities that the same seed makes the same, bit by bit."""

KEPT = {
    "backend", "output", "extensions", "stage", "cameras", "stereo", "rocks", "primitives",
    "groups", "objects", "movers", "layers", "pools", "texture_size_px", "texture_seed", "size_px",
    "detail", "variants", "name", "label", "semantic_id", "levels", "sky_levels", "effects",
    "passes", "sky_semantic_id", "time_budget_s", "quality", "samples", "pose_policy", "folder",
    "min_clearance_m", "shape", "count", "max_bounces", "rock_texture", "label_cell_m", "kind",
}  # fmt: skip
"""Keys that stay as they are, or that a strategy of their own draws."""

MOTIONS = st.sampled_from(
    [
        {"kind": "hover", "height_above_ground_m": [2.0, 5.0]},
        {"kind": "around_target", "distance_m": [4.0, 6.0], "elevation_deg": [30.0, 60.0]},
        {"kind": "grid", "columns": 2, "rows": 2, "altitude_m": 6.0},
        {"kind": "random", "position_m": [[-2, 2], [-2, 2], [9, 12]], "look": "down"},
    ]
)


def numbers(default: float, limits: tuple[float, float]) -> st.SearchStrategy[float]:
    low, high = (default * 0.5, default * 1.5) if default else (0.0, 0.5)
    low, high = max(min(low, high), limits[0]), min(max(low, high), limits[1])
    return st.floats(low, max(low, high), allow_nan=False).map(lambda value: round(value, 4))


def near(field: FieldInfo) -> st.SearchStrategy[Any] | None:
    """Return what to draw for a key; None: it stays as it is."""
    default, annotation = field.default, field.annotation
    if isinstance(default, BaseModel):
        return section(type(default))
    if get_origin(annotation) is Literal:
        return st.sampled_from(get_args(annotation))
    if isinstance(default, bool):
        return st.booleans()
    low, high = -1e9, 1e9
    for limit in field.metadata:
        low = max(low, getattr(limit, "ge", None) or low, (getattr(limit, "gt", None) or low))
        high = min(high, getattr(limit, "le", high), getattr(limit, "lt", high))
    if isinstance(default, int):
        return st.integers(max(int(low), default), min(int(high), default + 2))
    if isinstance(default, float):
        return numbers(default, (low, high))
    is_pair = isinstance(default, tuple) and len(default) == 2
    if is_pair and all(isinstance(value, float) for value in default):
        between = st.floats(0, 1).map(
            lambda t: default[0] + round(t, 3) * (default[1] - default[0])
        )
        return between.map(lambda value: [value, value])
    return None


@st.composite
def section(draw: st.DrawFn, model: type[BaseModel]) -> Json:
    """Draw some keys of a section; all others keep their defaults."""
    found: Json = {}
    for name, field in model.model_fields.items():
        strategy = None if name in KEPT else near(field)
        if strategy is not None and draw(st.integers(0, 2)) == 0:
            found[name] = draw(strategy)
    return found


@st.composite
def layers(draw: st.DrawFn) -> list[Json]:
    chosen = draw(st.lists(st.sampled_from(sorted(TEXTURES)), min_size=1, max_size=3, unique=True))
    return [
        {
            **draw(section(LayerConfig)),
            "texture": texture,
            "label": texture,
            "semantic_id": index + 1,
            "levels": [{"label": f"{texture} too", "semantic_id": index + 101}],
        }
        for index, texture in enumerate(chosen)
    ]


@st.composite
def groups(draw: st.DrawFn) -> list[Json]:
    shapes = draw(st.lists(st.sampled_from(sorted(SHAPES)), max_size=2, unique=True))
    return [
        {
            **draw(section(GroupConfig)),
            "name": shape,
            "shape": shape,
            "variants": 1,
            "detail": 1,
            "label": f"a {shape}",
            "semantic_id": index + 201,
            "count": [3, 12],
        }
        for index, shape in enumerate(shapes)
    ]


@st.composite
def configs(draw: st.DrawFn) -> Json:
    """Draw a small valid configuration for the analytic backend, as plain data."""
    data = draw(section(SimulationConfig).filter(_is_valid))
    data["seed"] = draw(st.integers(0, 2**32))
    data["backend"] = "analytic"
    data["stage"] = {
        "preset": draw(st.sampled_from(sorted(PRESETS))),
        "extent_m": draw(st.sampled_from([16.0, 30.0])),
        "resolution_px": draw(st.sampled_from([33, 65])),
        "relief_m": draw(st.sampled_from([None, 1.0, 4.0])),
    }
    materials = {"layers": draw(layers()), "texture_size_px": 64}
    data["materials"] = {**data.get("materials", {}), **materials}
    data["materials"].setdefault("mask", {})["size_px"] = 32
    rocks = draw(st.sampled_from([[], [{"kind": "slab", "count": [10, 20], "variants": 1}]]))
    data["assets"] = {"rocks": rocks, "groups": draw(groups())}
    data["sensors"] = {"pose_policy": "allow", "motion": draw(MOTIONS)}
    modalities = ["depth", "semantic_0", "semantic_1", "instance"]
    data["sensors"]["cameras"] = [
        {"width_px": 64, "height_px": 48, "fx_px": 50.0, "fy_px": 50.0, "modalities": modalities}
    ]
    return data


def _is_valid(data: Json) -> bool:
    try:
        config_from_mapping(data)
    except ConfigError:
        return False
    return True


def digest(data: Json, *extra: Module) -> str:
    """Return the hash of the exact images of two samples of a batch."""
    simulation = Simulation(config_from_mapping(data))
    modules = simulation._modules
    simulation._modules = replace(modules, all=(*modules.all, *extra))
    found = hashlib.sha256()
    simulation.step_batch()
    for _ in range(2):
        for frame in simulation.step_sample(modalities=EXACT).frames:
            found.update(frame.modality.encode() + frame.data.tobytes())
    return found.hexdigest()
