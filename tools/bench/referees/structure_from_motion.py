"""COLMAP's structure from motion, from pictures alone, against their true poses and K.

``python -m tools.bench.referees.structure_from_motion FOLDER FOCAL`` prints the figures as JSON.
The folder has ``images/`` and ``truth.json``, see `write_survey`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray, Frame
from tools.bench.referees.module_process import run_for_json

IMAGES, TRUTH = "images", "truth.json"


@dataclass(frozen=True)
class SurveyFigures:
    """What COLMAP makes of pictures; by default, nothing.

    Attributes:
        pictures, registered: Number of pictures, and of those whose pose it found.
        points: Number of points that it triangulated.
        reprojection_px: Mean reprojection error.
        position_rms_m: RMS distance of the cameras from the true ones, after the best similarity.
        position_rms_px: The same in pixels on the ground below the mean camera.
        rotation_median_deg: Median angle to the true orientation, after the same similarity.
        focal_share: Focal length that it found as a share of the true one, minus 1.
        principal_px: Distance of the principal point that it found from the true one.
    """

    pictures: int
    registered: int = 0
    points: int = 0
    reprojection_px: float = inf
    position_rms_m: float = inf
    position_rms_px: float = inf
    rotation_median_deg: float = inf
    focal_share: float = inf
    principal_px: float = inf


def write_survey(folder: Path, frames: Mapping[str, Frame], ground_m: float) -> None:
    """Write pictures and their true poses.

    Args:
        folder: Where to.
        frames: RGB frames by the name of their file; all of one camera.
        ground_m: Height of the ground, for the size of a pixel on it.
    """
    (folder / IMAGES).mkdir(parents=True, exist_ok=True)
    for name, frame in frames.items():
        bgr = cv2.cvtColor(np.asarray(frame.data, np.uint8), cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(folder / IMAGES / name), bgr)
    first = next(iter(frames.values()))
    truth = {
        "T_map_camera": {name: frame.T_map_camera.tolist() for name, frame in frames.items()},
        "K": first.intrinsics.K.tolist(),
        "ground_m": ground_m,
    }
    (folder / TRUTH).write_text(json.dumps(truth), encoding="utf-8")


def survey_figures(folder: Path, *, given_focal: float | None) -> SurveyFigures:
    """Return what COLMAP makes of a survey, in a process of its own.

    Args:
        folder: Written by `write_survey`.
        given_focal: Focal length that COLMAP is given, as a share of the true one, with the true
            principal point; None: it has to find K.

    Raises:
        ProgramError: COLMAP failed.
    """
    return SurveyFigures(**run_for_json(__name__, str(folder.absolute()), str(given_focal)))


def _reconstruct(folder: Path, truth: Mapping[str, Any], given_focal: float | None) -> Any:
    """Return COLMAP's largest model, or None."""
    import pycolmap

    pycolmap.set_random_seed(1)
    K = np.array(truth["K"])
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE")
    if given_focal is not None:
        # COLMAP's pixel centres are at 0.5, ours at 0.
        numbers = (given_focal * K[0, 0], given_focal * K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5)
        reader.camera_params = ",".join(map(repr, map(float, numbers)))
    with tempfile.TemporaryDirectory() as work:
        database = Path(work, "database.db")
        pycolmap.extract_features(
            database, folder / IMAGES, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader
        )
        pycolmap.match_exhaustive(database)
        options = pycolmap.IncrementalPipelineOptions()
        options.random_seed = 1
        options.ba_refine_focal_length = given_focal is None
        options.ba_refine_principal_point = given_focal is None
        options.ba_refine_extra_params = False
        models = pycolmap.incremental_mapping(database, folder / IMAGES, Path(work), options)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _figures(folder: Path, given_focal: float | None) -> SurveyFigures:
    truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
    poses = {name: np.array(T) for name, T in truth["T_map_camera"].items()}
    model = _reconstruct(folder, truth, given_focal)
    if model is None or model.num_reg_images() < 3:
        return SurveyFigures(len(poses))
    found, true = _align(model, poses)
    errors_m = np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1)
    rms_m = float(np.sqrt(np.mean(errors_m**2)))
    turned = np.einsum("nji,njk->nik", true[:, :3, :3], found[:, :3, :3])
    cosines = (np.trace(turned, axis1=1, axis2=2) - 1) / 2
    K, camera = np.array(truth["K"]), next(iter(model.cameras.values()))
    fx, fy, cx, cy = camera.params.tolist()
    height_m = float(true[:, 2, 3].mean()) - truth["ground_m"]
    return SurveyFigures(
        pictures=len(poses),
        registered=len(found),
        points=model.num_points3D(),
        reprojection_px=model.compute_mean_reprojection_error(),
        position_rms_m=rms_m,
        position_rms_px=rms_m * K[0, 0] / height_m,
        rotation_median_deg=float(np.degrees(np.median(np.arccos(np.clip(cosines, -1, 1))))),
        focal_share=float((fx / K[0, 0] + fy / K[1, 1]) / 2 - 1),
        principal_px=float(np.hypot(cx - 0.5 - K[0, 2], cy - 0.5 - K[1, 2])),
    )


def _align(model: Any, poses: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return (N, 4, 4) poses that were found, moved onto the true ones, and these."""
    images = [model.images[each] for each in model.reg_image_ids()]
    true = np.array([poses[image.name] for image in images])
    found = np.tile(np.eye(4), (len(images), 1, 1))
    for T, image in zip(found, images, strict=True):
        T[:3] = image.cam_from_world().inverse().matrix()
    scale, R, t = similarity(found[:, :3, 3], true[:, :3, 3])
    found[:, :3, 3] = scale * found[:, :3, 3] @ R.T + t
    found[:, :3, :3] = R @ found[:, :3, :3]
    return found, true


def similarity(
    found_m: FloatArray, true_m: FloatArray
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return scale, rotation and shift that best take (N, 3) points to others.

    Least squares (Umeyama, PAMI 13, 1991).
    """
    centres = found_m.mean(axis=0), true_m.mean(axis=0)
    a, b = found_m - centres[0], true_m - centres[1]
    U, S, Vt = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ np.diag(signs) @ Vt
    scale = float((S * signs).sum() / (a**2).sum())
    return scale, R, centres[1] - scale * R @ centres[0]


def main() -> None:
    """Print the figures of a folder as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("given", help="a number, or None")
    options = parser.parse_args()
    found = _figures(options.folder, None if options.given == "None" else float(options.given))
    print(json.dumps(asdict(found)))


if __name__ == "__main__":
    main()
