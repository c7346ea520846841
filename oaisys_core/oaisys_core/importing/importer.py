"""Conversion of an original configuration file to one of ours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from oaisys_core.errors import ConfigError, InvalidInputError, one_line, show_field
from oaisys_core.files.yaml_documents import yaml_comments
from oaisys_core.importing.assets import assets, stage
from oaisys_core.importing.context import ImportContext
from oaisys_core.importing.document import (
    Json,
    entries,
    key_paths,
    load_document,
    part,
)
from oaisys_core.importing.environment import environment
from oaisys_core.importing.forms import check_forms
from oaisys_core.importing.key_outcomes import KeyOutcome, outcome_of
from oaisys_core.importing.limits import clamp
from oaisys_core.importing.materials import materials
from oaisys_core.importing.sensors import sensors
from oaisys_core.importing.stand_ins import StandIns

DEVICES = {"CPU": "cpu", "GPU": "auto"}
"""Our device for each device of the original."""

UNKNOWN = KeyOutcome("no counterpart", "this key is unknown")


@dataclass(frozen=True)
class ImportedConfig:
    """The result of an import.

    Attributes:
        config: Our configuration, as plain data.
        outcomes: What became of each key in the file.
        warnings: Notes on what was replaced or left out.
    """

    config: Json
    outcomes: dict[str, KeyOutcome]
    warnings: tuple[str, ...]

    def notes(self) -> list[str]:
        """Return one line per key that was not mapped, and one per warning, whatever keys have."""
        unmapped = {
            path: outcome for path, outcome in self.outcomes.items() if outcome.kind != "mapped"
        }
        keys = [
            f"{path}: {outcome.kind}: {outcome.text}" for path, outcome in sorted(unmapped.items())
        ]
        return [one_line(each) for each in (*keys, *(f"warning: {w}" for w in self.warnings))]

    def text(self, source: str) -> str:
        """Return the YAML file, with the notes as comments."""
        head = [f"Imported from {source}. What could not be imported:", *self.notes()]
        body = yaml.safe_dump(self.config, sort_keys=False, allow_unicode=True)
        return yaml_comments(head) + str(body)


def import_file(
    path: Path,
    assets_folder: Path | None = None,
    out: Path | None = None,
    *,
    strict: bool = False,
    stand_ins: Path | None = None,
) -> ImportedConfig:
    """Return our configuration for an original JSON file.

    Args:
        path: The file.
        assets_folder: Folder from which its relative paths start; None if all files are missing.
        out: Path of the result; pose files are written beside it.
        strict: Whether missing files and unknown keys are errors.
        stand_ins: Folder for generated files that replace missing ones; None replaces them by
            built-in textures and shapes.

    Raises:
        ConfigError: The file is invalid, or ``strict`` and incomplete.
    """
    document = load_document(path)
    try:
        check_forms(document)
    except InvalidInputError as error:
        raise ConfigError(f"{path}: {error}") from error
    outcomes = {key: outcome_of(key) or UNKNOWN for key in key_paths(document)}
    unknown = sorted(key for key, outcome in outcomes.items() if outcome is UNKNOWN)
    if strict and unknown:
        raise ConfigError("\n".join(f"{path}: {show_field(key)}: unknown key" for key in unknown))
    if strict and stand_ins is not None:
        raise InvalidInputError("--stand-ins", str(stand_ins), "none with --strict")
    made = None if stand_ins is None else StandIns(stand_ins)
    job = ImportContext(assets_folder, out, is_strict=strict, stand_ins=made)
    config = _convert(document, job)
    if job.missing:
        faults = dict.fromkeys(job.missing)
        raise ConfigError("\n".join(_missing(path, fault, assets_folder) for fault in faults))
    job.rename_shared(config)
    for warning in clamp(config, outcomes, str(path)):
        job.warn(warning)
    return ImportedConfig(config, outcomes, tuple(job.warnings))


def _missing(path: Path, fault: str, assets_folder: Path | None) -> str:
    if assets_folder is None:
        return f"{path}: {fault}: --strict needs --assets, the folder that its paths start from"
    return f"{path}: {fault}, expected it below {assets_folder} (--assets)"


def _convert(document: Json, job: ImportContext) -> Json:
    ground, material_name = stage(document, job)
    extent_m = float(ground.get("extent_m", 200.0))
    # The sky comes first, because its label has a fixed name.
    air = environment(document, job)
    things, targets = assets(document, job, extent_m)
    found: Json = {"backend": "blender", "stage": ground}
    if entries(document, "ASSET_SETUP", "STAGES"):
        found["materials"] = materials(document, job, material_name, extent_m)
        if "mesh" in ground:
            found["materials"]["displacement"] = "bump"
            job.warn("height maps only shade a stage that is a mesh: they do not move its surface")
    return found | {
        "assets": things,
        "environment": air,
        "sensors": sensors(document, job, targets),
        "render": _render(document, job),
        "output": _output(part(document, "SIMULATION_SETUP")),
    }


def _render(document: Json, job: ImportContext) -> Json:
    found: Json = {}
    device = part(document, "RENDER_SETUP", "GENERAL").get("renderDevice")
    if device in DEVICES:
        found["device"] = DEVICES[device]
    elif device is not None:
        job.warn(f"the render device {device} is unknown, expected {' or '.join(DEVICES)}")
    for entry in entries(document, "RENDER_SETUP", "RENDER_PASSES"):
        params = part(entry, "passParams")
        if entry.get("type") == "RGBDPass":
            found["samples"] = int(params.get("renderSamples", 128))
            found["max_bounces"] = int(params.get("lightPathesMaxBounces", 6))
    section = "RENDER_POST_PROCESSING_EFFECTS_SETUP"
    for entry in entries(document, section, "POST_EFFECTS"):
        if entry.get("type") != "BloomEffect":
            job.warn(f"the effect {entry.get('type')} is left out: only bloom is supported")
            continue
        params = part(entry, "effectParams")
        bloom: Json = {"threshold": float(params.get("threshold", 1.0))}
        if "size" in params:
            # The size of a glow is the logarithm, to base 2, of its width in pixels.
            bloom["radius_px"] = 2.0 ** float(params["size"]) / 6
        if "mix" in params:
            # From -1 (image only) to 1 (glow only); 0 is an equal mix.
            bloom["strength"] = (float(params["mix"]) + 1) / 2
        found["effects"] = {"bloom": bloom}
    return found


def _output(run: Json) -> Json:
    found: Json = {
        "batches": int(run.get("numBatches", 1)),
        "samples": int(run.get("numSamplesPerBatch", 1)),
        "batch_offset": int(run.get("outputIDOffset", 0)),
        "save_blend": bool(run.get("saveBlenderFiles", False)),
    }
    return found | ({"folder": str(run["outputPath"])} if run.get("outputPath") else {})
