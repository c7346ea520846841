"""The files that the live page writes: pictures, poses and configurations."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from oaisys_core.errors import OaisysError
from oaisys_core.files.documents import read_text
from oaisys_core.files.folders import make_folder
from oaisys_core.files.whole_files import write_whole_bytes
from oaisys_core.types import Frame, ModuleMetadata, Pose, Sample, merge

PROVENANCE_KEY = "oaisys"
"""Name of the text in a picture that says how to render it again."""

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
"""Columns of a file of poses, as ``oaisys render --poses`` reads them."""


class Outputs:
    """Writes numbered files into a folder; none that is there is replaced."""

    def __init__(self, folder: Path) -> None:
        """Make the folder.

        Raises:
            InvalidInputError: There can be none of this name.
        """
        self.folder = make_folder(folder)
        self._poses: Path | None = None

    def write_picture(self, sample: Sample, frame: Frame) -> Path:
        """Write a colour image as PNG, with its provenance as text in it, and return its path."""
        path = self.new_path("picture_", ".png")
        return _write(path, picture_png(sample, frame))

    def write_config(self, config_json: str, changes: ModuleMetadata, seed: int) -> Path:
        """Write the configuration with what the page has changed, and return its path.

        Args:
            config_json: The simulator's configuration.
            changes: What the page has changed since.
            seed: Of the world that is shown, which a configuration does not hold.
        """
        if not config_json:
            raise OaisysError("the simulator is older and does not tell its configuration")
        text = f"# oaisys render --config FILE --world-seed {seed} has the world that was shown.\n"
        changed = apply_changes(json.loads(config_json), changes)
        text += yaml.safe_dump(changed, sort_keys=False, allow_unicode=True)
        return _write(self.new_path("config_", ".yaml"), text.encode())

    def keep_pose(self, pose: Pose) -> tuple[Path, int]:
        """Append a pose of the rig to this session's survey; return its path and how many it has.

        Raises:
            OaisysError: It cannot be read or written; the file is as before.
        """
        path = self._poses or self.new_path("survey_", ".csv")
        lines = _lines_of(path) or [",".join(POSE_COLUMNS)]
        lines.append(",".join(map(repr, (*pose.position_m, *pose.quat_xyzw))))
        _write(path, "".join(f"{line}\n" for line in lines).encode())
        self._poses = path
        return path, len(lines) - 1

    def new_path(self, beginning: str, ending: str) -> Path:
        """Return the path with the least number that nothing has yet."""
        number = 1
        # A link that leads nowhere is there, too.
        while os.path.lexists(path := self.folder / f"{beginning}{number:04d}{ending}"):
            number += 1
        return path


def picture_png(sample: Sample, frame: Frame) -> bytes:
    """Return a colour image as PNG whose text `PROVENANCE_KEY` is JSON.

    It has the sample's ids, the poses, the camera and the provenance.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    record = {
        "batch_id": sample.batch_id,
        "sample_id": sample.sample_id,
        "rig_pose": asdict(sample.rig_pose),
        "sensor": frame.sensor,
        "modality": frame.modality,
        "intrinsics": asdict(frame.intrinsics),
        "T_map_camera": frame.T_map_camera.tolist(),
        "provenance": asdict(sample.provenance),
    }
    text = PngInfo()
    text.add_itxt(PROVENANCE_KEY, json.dumps(record))
    buffer = io.BytesIO()
    Image.fromarray(frame.data).save(buffer, "PNG", pnginfo=text)
    return buffer.getvalue()


def apply_changes(config: Mapping[str, Any], changes: ModuleMetadata) -> dict[str, Any]:
    """Return a configuration with metadata's changes in the sections that they are of."""
    sections = {
        "environment": changes.environment,
        "render": changes.render,
        **changes.custom,
    }
    return merge(config, {name: part for name, part in sections.items() if part})


def _lines_of(path: Path) -> list[str]:
    """Return the lines of a text, which may have been edited meanwhile; none where it is gone."""
    try:
        return read_text(path).splitlines()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise OaisysError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise OaisysError(f"{path}: {error}") from error


def _write(path: Path, data: bytes) -> Path:
    try:
        write_whole_bytes(path, data)
    except OSError as error:
        raise OaisysError(f"{path}: {error.strerror or error}") from error
    return path
