"""The shell command ``oaisys evaluate``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.whole_files import check_output_file, write_whole_text

if TYPE_CHECKING:
    from oaisys_mapping.tsdf import TsdfVolume

LengthOption = Annotated[float | None, typer.Option(help="Metres.", min=0)]
MedianOption = Annotated[
    float | None, typer.Option(help="Metres; limit of the median error.", min=0)
]
OffsetOption = Annotated[
    float | None, typer.Option(help="Metres; limit of the shift between map and truth.", min=0)
]
CompletionOption = Annotated[
    float | None, typer.Option(help="Share of visible truth within a voxel.", min=0, max=1)
]
FScoreOption = Annotated[float | None, typer.Option(help="At one voxel.", min=0, max=1)]
HolesOption = Annotated[
    float | None, typer.Option(help="Share of the surveyed surface.", min=0, max=1)
]
OverlapHolesOption = Annotated[
    int | None, typer.Option(help="Number of holes where at least two views see.", min=0)
]
IouOption = Annotated[
    float | None, typer.Option(help="Of each class with at least 1 % of the surface.", min=0, max=1)
]
TausOption = Annotated[
    list[float] | None,
    typer.Option("--tau", help="Metres; tolerance of a further F-score, repeatable."),
]
VolumeOption = Annotated[
    Path | None, typer.Option(help="The mapper's volume (.npz), to evaluate its distances too.")
]


def evaluate(
    mesh: Annotated[Path, typer.Option(help="Reconstructed mesh (PLY, OBJ, STL, GLB).")],
    truth: Annotated[Path, typer.Option(help="True mesh, in the same frame and in metres.")],
    poses: Annotated[
        Path | None,
        typer.Option(help="poses.json of a survey: only truth visible from these poses counts."),
    ] = None,
    volume: VolumeOption = None,
    voxel_size: Annotated[float, typer.Option(help="Metres; the tolerance.", min=1e-6)] = 0.10,
    max_range: Annotated[float, typer.Option(help="Metres of depth that count.", min=1e-3)] = 60.0,
    tau: TausOption = None,
    max_rmse: LengthOption = None,
    max_median: MedianOption = None,
    max_offset: OffsetOption = None,
    min_completion: CompletionOption = None,
    min_f_score: FScoreOption = None,
    max_holes: HolesOption = None,
    max_overlap_holes: OverlapHolesOption = None,
    min_iou: IouOption = None,
    seed: Annotated[int, typer.Option(help="Seed of the sampled points.", min=0)] = 0,
    json_path: Annotated[
        Path | None, typer.Option("--json", help="Also write the figures to this file.")
    ] = None,
) -> None:
    """Measure a reconstruction against the truth: JSON figures, exit 1 if a threshold is missed.

    Without --poses all of the truth counts as visible.
    """
    # `oaisys --help` imports this module, so slow imports wait until the command runs.
    import numpy as np

    from oaisys_core.system.progress_display import show_stages
    from oaisys_mapping.certificate.view_files import read_views
    from oaisys_mapping.evaluation.evaluate import Extras, evaluate_reconstruction
    from oaisys_mapping.evaluation.thresholds import Thresholds
    from oaisys_mapping.evaluation.truth_io import read_truth
    from oaisys_mapping.mesh_io import read_ply

    if json_path is not None:
        if not json_path.parent.is_dir():
            raise InvalidInputError("--json", str(json_path), "a file in an existing folder")
        check_output_file(json_path, "--json")
    taus_m = tuple(tau or ())
    if any(not (np.isfinite(tau_m) and tau_m > 0) for tau_m in taus_m):
        raise InvalidInputError("--tau", list(taus_m), "metres above 0")
    views = None if poses is None else read_views(poses)
    field = None if volume is None else _volume(volume, voxel_size)
    with show_stages("measuring", partial(typer.echo, err=True)) as on_progress:
        on_progress("reading the meshes")
        evaluation = evaluate_reconstruction(
            read_ply(mesh),
            read_truth(truth),
            views,
            voxel_size,
            max_range,
            np.random.default_rng(seed),
            Extras(taus_m, field, on_progress=on_progress),
        )
    thresholds = Thresholds(
        max_rmse_m=max_rmse,
        min_completion=min_completion,
        min_f_score=min_f_score,
        max_holes=max_holes,
        max_median_m=max_median,
        max_offset_m=max_offset,
        max_overlap_holes=max_overlap_holes,
        min_iou=min_iou,
    )
    _require_measured(evaluation.missing_figures, max_offset, max_overlap_holes, min_iou)
    missed = thresholds.misses_of(evaluation.metrics)
    figures = {
        **evaluation.metrics.to_dict(),
        "max_range_m": max_range,
        "visible_from": "everywhere" if views is None else f"{len(views)} poses",
        "thresholds": asdict(thresholds),
        "missed": missed,
        "closed": not missed,
    }
    _print(figures, json_path)
    if missed:
        raise typer.Exit(1)


def _require_measured(
    unmeasured: Mapping[str, str],
    max_offset: float | None,
    max_overlap_holes: int | None,
    min_iou: float | None,
) -> None:
    """Raise where a limit is given of a figure that nothing was measured of."""
    limits = {
        "offset_m": ("--max-offset", max_offset),
        "overlap_hole_count": ("--max-overlap-holes", max_overlap_holes),
        "least_iou": ("--min-iou", min_iou),
    }
    for figure, missing in unmeasured.items():
        option, limit = limits[figure]
        if limit is not None:
            raise InvalidInputError(option, limit, f"no limit on {figure}: {missing}")


def _print(figures: dict[str, Any], json_path: Path | None) -> None:
    text = json.dumps(figures, indent=2)
    if json_path is not None:
        write_whole_text(json_path, f"{text}\n")
    typer.echo(text)


def _volume(path: Path, voxel_size_m: float) -> TsdfVolume:
    from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume

    found = TsdfVolume(TsdfConfig(voxel_size_m=voxel_size_m))
    found.load(path)
    return found
