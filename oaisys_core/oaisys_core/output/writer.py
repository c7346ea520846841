"""Writing samples to files, in the folder layout of the original simulator.

::

    config.yaml                                   the complete configuration and its hash
    state.json                                    state of the run, for `SampleWriter.resume`
    batch_0001/poses.csv                          the rig's pose at each sample
    batch_0001/odometry.csv                       estimated pose, if odometry drifts
    batch_0001/labels.json                        label names by semantic id
    batch_0001/counts.json                        of each group of objects, the numbers asked for
                                                  and placed
    batch_0001/camera/0001camera_rgb_00.png       images, see `oaisys_core.output.images`
    batch_0001/camera/intrinsics.json             of the sensor's first sample in the batch
    batch_0001/lidar/0001lidar_points_00.pcd      points, see `oaisys_core.output.points`
    batch_0001/meta_data/sensor_data/camera.csv   pose of the optical frame at each sample; of a
                                                  lidar, pose at the beginning of the scan
    batch_0001/meta_data/sample_data/0001.json    provenance, intrinsics and poses of a sample
    batch_0001/blender_file/TSS_batch_0001.blend  on request
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from oaisys_core.config import SimulationConfig, config_sha256
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.names import path_inside
from oaisys_core.geometry import pose_from_matrix
from oaisys_core.output.files import write_text
from oaisys_core.output.images import file_suffix, write_image
from oaisys_core.output.points import POINTS_SUFFIX, write_points
from oaisys_core.output.poses import append_pose, drop_poses_after
from oaisys_core.output.records import intrinsics_record, read_json, sample_record, write_json
from oaisys_core.types import GroupCount, Sample

CONFIG, STATE = "config.yaml", "state.json"
POSES, LABELS, INTRINSICS = "poses.csv", "labels.json", "intrinsics.json"
COUNTS = "counts.json"
ODOMETRY = "odometry.csv"
BLENDER_FILES = "blender_file"
SENSOR_DATA, SAMPLE_DATA = Path("meta_data/sensor_data"), Path("meta_data/sample_data")


class SampleWriter:
    """Writes samples into one folder; each file is written atomically.

    All methods that write may raise `RenderError`, for instance if the disk is full.
    """

    def __init__(self, out: Path, batch_offset: int = 0) -> None:
        """Write into ``out``; ``batch_offset`` is added to the numbers of batch folders."""
        self._out = out
        self._batch_offset = batch_offset
        self._has_begun = False

    def begin(self, config: SimulationConfig) -> None:
        """Start a run by writing its configuration.

        Raises:
            InvalidInputError: The folder contains a run already.
        """
        if (self._out / CONFIG).exists() or any(self._out.glob("batch_*")):
            expected = "a folder without an earlier run, or --resume to continue that run"
            raise InvalidInputError("out", str(self._out), expected)
        write_text(self._out / CONFIG, config_text(config))
        self._has_begun = True

    def withdraw(self) -> None:
        """Remove what `begin` has written if no sample followed, so that a run can begin again."""
        if not self._has_begun or (self._out / STATE).exists():
            return
        (self._out / CONFIG).unlink(missing_ok=True)
        for batch in self._out.glob("batch_*"):
            (batch / COUNTS).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # something else has been written
                batch.rmdir()

    def resume(self, config: SimulationConfig) -> dict[str, Any] | None:
        """Return the state of the run in the folder, or None if it has not written a sample yet.

        Rows of later samples are removed; their files will be overwritten.

        Raises:
            InvalidInputError: There is no run, its configuration differs, or one of its folders is
                a link, which leads out of it.
        """
        path = self._out / CONFIG
        if not path.is_file():
            raise InvalidInputError("out", str(self._out), f"a run to resume, with its {CONFIG}")
        if path.read_text(encoding="utf-8") != config_text(config):
            expected = f"a run with this configuration; that in {path} differs"
            raise InvalidInputError("out", str(self._out), expected)
        for each in (*self._out.glob("batch_*"), *self._out.glob("batch_*/*")):
            if each.is_symlink():
                raise InvalidInputError("out", str(each), "a folder or file of the run, not a link")
        state: dict[str, Any] | None = None
        if (self._out / STATE).is_file():
            state = _check_state(read_json(self._out / STATE), self._out / STATE)
        self._drop_rows_after(state)
        return state

    def write(self, sample: Sample, labels: Mapping[int, str] | None = None) -> list[Path]:
        """Write a sample and return the files of its images and points.

        Args:
            sample: The rendered sample.
            labels: Label names by semantic id; written once per batch.
        """
        batch = self.batch_folder(sample.batch_id)
        paths, files = [], {}
        for frame in sample.frames:
            name = f"{sample.sample_id:04d}{frame.sensor}_{file_suffix(frame)}"
            path = path_inside(batch, frame.sensor, name)
            write_image(path, frame)
            paths.append(path)
            files[frame.sensor, frame.modality] = str(path.relative_to(batch))
        for scan in sample.scans:
            name = f"{sample.sample_id:04d}{scan.sensor}_{POINTS_SUFFIX}"
            path = path_inside(batch, scan.sensor, name)
            write_points(path, scan)
            paths.append(path)
            files[scan.sensor, scan.modality] = str(path.relative_to(batch))
        if labels is not None and not (batch / LABELS).exists():
            write_json(batch / LABELS, {str(i): label for i, label in sorted(labels.items())})
        self._write_sensors(batch, sample)
        append_pose(batch / POSES, sample.sample_id, sample.rig_pose)
        if sample.odometry is not None:
            append_pose(batch / ODOMETRY, sample.sample_id, sample.odometry.pose)
        record = sample_record(sample, files)
        write_json(batch / SAMPLE_DATA / f"{sample.sample_id:04d}.json", record)
        return paths

    def write_counts(self, batch_id: int, counts: Sequence[GroupCount]) -> None:
        """Write how many objects of each group a batch has; nothing for a batch without groups."""
        if counts:
            record = {each.name: {"asked": each.asked, "placed": each.placed} for each in counts}
            write_json(self.batch_folder(batch_id) / COUNTS, record)

    def write_state(self, state: Mapping[str, Any]) -> None:
        """Write the state of the simulation, after everything else."""
        write_json(self._out / STATE, state)

    def has_measurements(self) -> bool:
        """Return whether an image or a scan of any sensor was written, by this run or before."""
        folders = (each for each in self._out.glob("batch_*/*") if each.name != BLENDER_FILES)
        return any(path.is_file() for folder in folders for path in folder.glob("*"))

    def batch_folder(self, batch_id: int) -> Path:
        """Return the folder of a batch."""
        return self._out / f"batch_{batch_id + self._batch_offset:04d}"

    def blend_file(self, batch_id: int) -> Path:
        """Return the file to which the world of a batch is saved."""
        number = f"{batch_id + self._batch_offset:04d}"
        return self.batch_folder(batch_id) / BLENDER_FILES / f"TSS_batch_{number}.blend"

    def _drop_rows_after(self, state: Mapping[str, Any] | None) -> None:
        last = "" if state is None else self.batch_folder(state["last_batch_id"]).name
        for batch in self._out.glob("batch_*"):
            if batch.name < last:
                continue
            kept = state["batch"]["sample_id"] if state and batch.name == last else 0
            for table in (
                *batch.glob(POSES),
                *batch.glob(ODOMETRY),
                *(batch / SENSOR_DATA).glob("*.csv"),
            ):
                drop_poses_after(table, kept)

    def _write_sensors(self, batch: Path, sample: Sample) -> None:
        for frame in {frame.sensor: frame for frame in sample.frames}.values():
            camera = batch / frame.sensor / INTRINSICS
            if not camera.exists():
                write_json(camera, intrinsics_record(frame.intrinsics))
            table = batch / SENSOR_DATA / f"{frame.sensor}.csv"
            append_pose(table, sample.sample_id, pose_from_matrix(frame.T_map_camera))
        for scan in sample.scans:
            table = batch / SENSOR_DATA / f"{scan.sensor}.csv"
            append_pose(table, sample.sample_id, pose_from_matrix(scan.T_map_lidar))


def _check_state(state: Any, path: Path) -> dict[str, Any]:
    """Return the state of a run; what is in it beyond the ids is the simulation's to check."""
    ids = (state, "last_batch_id"), (state and state.get("batch"), "sample_id")
    for record, key in ids if isinstance(state, dict) else [(None, "")]:
        found = record.get(key) if isinstance(record, dict) else None
        if not isinstance(found, int) or found < 0:
            raise InvalidInputError(f"{path}: {key}", found, "the state of a run, with its ids")
    return dict(state)


def config_text(config: SimulationConfig) -> str:
    """Return the text of a YAML file with a configuration, defaults included."""
    data = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    return f"# sha256 {config_sha256(config)}\n{data}"
