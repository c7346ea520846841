"""Reading the metadata of batches and samples from a YAML or JSON file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oaisys_core.errors import InvalidInputError, did_you_mean
from oaisys_core.files.documents import read_text
from oaisys_core.files.yaml_documents import parse_yaml
from oaisys_core.geometry import check_pose
from oaisys_core.types import OWN_PARTS, ModuleMetadata, Pose

if TYPE_CHECKING:
    from oaisys_core.simulation import Simulation

_STEPS = ("batch", "samples")
_SELECTIONS = ("modalities", "sensors")


@dataclass(frozen=True)
class SampleRequest:
    """The arguments of one sample, see `Simulation.step_sample`."""

    metadata: ModuleMetadata = field(default_factory=ModuleMetadata)
    modalities: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True)
class Steps:
    """The steps of a whole run.

    Attributes:
        batch: Metadata of all batches.
        samples: The samples of each batch, in order.
    """

    batch: ModuleMetadata
    samples: tuple[SampleRequest, ...]

    @property
    def count(self) -> int:
        """Number of samples of each batch."""
        return len(self.samples)

    def requests(self, simulation: Simulation) -> tuple[SampleRequest, ...]:
        """Return the samples in a simulation's current world, which are the same in all."""
        return self.samples


def load_steps(path: Path) -> Steps:
    """Return the steps in a file.

    The file is a list of samples, or a mapping with ``batch`` and ``samples``. A sample is a
    mapping of metadata by module (``sensor``, ``environment``, ``asset``, ``render`` and others by
    name); it may also contain ``modalities`` and ``sensors`` to render. A pose is a mapping with
    ``position_m`` and ``quat_xyzw``. Without ``samples``, there is one.

    Raises:
        InvalidInputError: The file cannot be read or does not have this form. The modules check the
            metadata itself.
    """
    try:
        data = parse_yaml(read_text(path))
    except (OSError, ValueError) as error:
        raise InvalidInputError("metadata", str(path), f"a readable file ({error})") from error
    if isinstance(data, list):
        data = {"samples": data}
    if not isinstance(data, Mapping) or not set(data) <= set(_STEPS):
        unknown = next((key for key in data or () if key not in _STEPS), None)
        expected = f"a list of samples, or batch and samples{did_you_mean(unknown, _STEPS)}"
        raise InvalidInputError("metadata", str(path), expected)
    samples = data.get("samples", [{}])
    if not isinstance(samples, list) or not samples:
        raise InvalidInputError("metadata.samples", samples, "a list of at least one sample")
    return Steps(
        batch=_metadata(_mapping(data.get("batch"), "metadata.batch"), "metadata.batch"),
        samples=tuple(
            _sample(_mapping(sample, f"metadata.samples.{i}"), f"metadata.samples.{i}")
            for i, sample in enumerate(samples)
        ),
    )


def _sample(data: Mapping[str, Any], path: str) -> SampleRequest:
    parts = {key: value for key, value in data.items() if key not in _SELECTIONS}
    for key, value in parts.items():
        if value is not None and not isinstance(value, Mapping):
            hint = did_you_mean(key, (*OWN_PARTS, *_SELECTIONS))
            raise InvalidInputError(f"{path}.{key}", value, f"a mapping{hint}")
    return SampleRequest(
        metadata=_metadata(parts, path),
        modalities=_names(data.get("modalities"), f"{path}.modalities"),
        sensors=_names(data.get("sensors"), f"{path}.sensors"),
    )


def _metadata(data: Mapping[str, Any], path: str) -> ModuleMetadata:
    parts = {name: _mapping(part, f"{path}.{name}") for name, part in data.items()}
    sensor = parts.get("sensor")
    if sensor is not None and "pose" in sensor:
        parts["sensor"] = {**sensor, "pose": _pose(sensor["pose"], f"{path}.sensor.pose")}
    own = {name: part for name, part in parts.items() if name in OWN_PARTS}
    others = {name: part for name, part in parts.items() if name not in OWN_PARTS}
    return ModuleMetadata(**own, custom=others)


def _pose(data: object, path: str) -> Pose:
    pose = _mapping(data, path)
    if set(pose) != {"position_m", "quat_xyzw"}:
        raise InvalidInputError(path, dict(pose), "position_m and quat_xyzw")
    return check_pose(pose["position_m"], pose["quat_xyzw"], path)


def _names(data: object, path: str) -> tuple[str, ...]:
    if data is None:
        return ()
    if not isinstance(data, list) or not all(isinstance(name, str) for name in data):
        raise InvalidInputError(path, data, "a list of names")
    return tuple(data)


def _mapping(data: object, path: str) -> Mapping[str, Any]:
    if data is None:
        return {}
    if not isinstance(data, Mapping) or not all(isinstance(key, str) for key in data):
        raise InvalidInputError(path, data, "a mapping")
    return data
