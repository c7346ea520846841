"""``oaisys dataset render`` and ``oaisys dataset repeat``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.cli.options import BackendOption, QualityOption, SeedOption, SizeOption
from oaisys_core.cli.repeat import MIN_PSNR_DB, DifferentSampleError, describe
from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import OaisysError
from oaisys_dataset.cli.export import PlaceArgument, export_place, write_export
from oaisys_dataset.plan import MAX_WORLDS, SPLITS, parse_splits
from oaisys_dataset.rendering.ray_settings import MEMORY_PER_WORKER_GB, RaySettings

if TYPE_CHECKING:
    from oaisys_core.config import SimulationConfig
    from oaisys_dataset.places import StoragePlace
    from oaisys_dataset.rendering.dataset_rendering import DatasetRendering, DatasetSummary

OUT = "out/dataset"
"""Folder of a data set, by default."""


class IncompleteDatasetError(OaisysError):
    """Some worlds of a data set could not be made."""


def render(
    config: Annotated[
        Path, typer.Argument(help="YAML file: what worlds and views are drawn from.")
    ],
    out: Annotated[str, typer.Option(help="Folder or URL of the data set.")] = OUT,
    worlds: Annotated[int, typer.Option(help="Number of worlds.", min=1, max=MAX_WORLDS)] = 10,
    views: Annotated[
        int, typer.Option(help="Number of views of each world.", min=1, max=MAX_WORLDS)
    ] = 30,
    splits: Annotated[
        str, typer.Option(help="Share of the worlds in each split; a world is in one of them.")
    ] = SPLITS,
    num_workers: Annotated[
        int | None,
        typer.Option(
            help="Worlds rendered at a time; default: one for each core that has the memory.", min=1
        ),
    ] = None,
    memory_per_worker: Annotated[
        float, typer.Option(help="Memory reserved for each worker, in GB.", min=0.1)
    ] = MEMORY_PER_WORKER_GB,
    gpus_per_worker: Annotated[
        float,
        typer.Option(
            help="GPUs that each worker has for itself; 0.5: two workers share one;"
            " 0: all workers of a machine see all its GPUs.",
            min=0,
        ),
    ] = 0.0,
    address: Annotated[
        str | None,
        typer.Option(
            help="HOST:PORT of a Ray cluster, or the variable RAY_ADDRESS; default: this machine."
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue the data set in --out; it may get more worlds."),
    ] = False,
    formats: Annotated[
        str, typer.Option(help="Formats to export afterwards, such as coco,webdataset.")
    ] = "",
    seed: SeedOption = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
) -> None:
    """Render many worlds into a data set, on this machine or on a Ray cluster.

    CONFIG gives ranges for the worlds, and in sensors.motion the views. Each world becomes a shard,
    which is written whole or not at all; after an interruption, --resume renders what is missing.
    Exit code 1: some worlds could not be made; their reasons are in OUT/failed.
    """
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_core.config import adjust, load_config
    from oaisys_dataset.places import open_place
    from oaisys_dataset.rendering.dataset_rendering import DatasetRendering, dataset_info
    from oaisys_dataset.rendering.views import check_views_differ, check_views_have_frames

    shares = parse_splits(splits)
    place = open_place(out)
    chosen = adjust(load_config(config), seed=seed, backend=backend, quality=quality, size=size)
    check_views_have_frames(chosen, views)
    check_views_differ(chosen, views)
    names = _format_names(formats, chosen)
    settings = RaySettings(address, num_workers, memory_per_worker, gpus=gpus_per_worker)
    rendering = DatasetRendering(place, chosen, dataset_info(chosen, worlds, views, shares))
    with rendering.begin(is_resumed=resume):
        _run(rendering, settings)
        _report(rendering.summary)
        _export(place, names)
    failed = len(rendering.summary.failures)
    if failed:
        text = f"{failed} of {worlds} worlds could not be made; --resume tries them again"
        raise IncompleteDatasetError(text)


def repeat(
    place: PlaceArgument,
    frames: Annotated[
        list[str],
        typer.Argument(
            metavar="FRAME...", help="Ids of frames or lidar scans, such as 000012_0003_camera."
        ),
    ],
    least_psnr: Annotated[
        float, typer.Option(help="Least PSNR of colours, in dB.", min=0)
    ] = MIN_PSNR_DB,
) -> None:
    """Render frames of a data set again from their lines in the manifest, and compare.

    Depth, labels, instance ids, normals and lidar points must be equal byte by byte, colours within
    --least-psnr.
    Exit code 0: equal; 1: something differs; 2: there is no such frame.
    """
    from oaisys_dataset.reader import open_dataset
    from oaisys_dataset.repeat import repeat_records

    dataset = open_dataset(place)
    different = 0
    with own_stdout():
        for frame, comparisons in repeat_records(dataset, frames, least_psnr):
            is_same = all(each.is_equal for each in comparisons)
            different += not is_same
            typer.echo(f"{frame}: {'equal' if is_same else 'DIFFERENT'}")
            for each in comparisons:
                typer.echo(f"  {describe(each)}")
    if different:
        raise DifferentSampleError(f"{different} of {len(frames)} frames differ from the data set")


def _run(rendering: DatasetRendering, settings: RaySettings) -> None:
    from oaisys_dataset.cli.progress import DatasetProgress
    from oaisys_dataset.manifest import WorldFailure

    summary = rendering.summary
    with DatasetProgress(summary, rendering.info.views) as shown:
        try:
            for event in rendering.run(settings):
                if isinstance(event, WorldFailure):
                    typer.echo(f"world {event.world} failed: {event.reason}", err=True)
                shown.update()
        except BaseException:
            done = summary.kept + summary.finished
            shown.stop()
            text = f"stopped after {done} of {summary.planned} worlds; --resume renders the others"
            typer.echo(text, err=True)
            raise


def _report(summary: DatasetSummary) -> None:
    """Print what was rendered, and the balance of the classes."""
    typer.echo(
        f"{summary.kept + summary.finished} of {summary.planned} worlds are finished, "
        f"{summary.kept} of them by earlier commands; {len(summary.failures)} failed"
    )
    if summary.label_pixels:
        typer.echo("share of all pixels by class:")
    for label, share in summary.class_shares().items():
        typer.echo(f"  {label or 'unlabelled':<24} {share:8.3%}")


def _format_names(formats: str, config: SimulationConfig) -> list[str]:
    """Return the formats of a text such as ``coco,webdataset``, which suit what is rendered."""
    names = [name.strip() for name in formats.split(",") if name.strip()]
    if not names:
        return []
    from oaisys_dataset.formats.base import check_suits, format_named

    found = [format_named(name) for name in dict.fromkeys(names)]
    cameras = config.sensors.all_cameras
    modalities = set(filter(config.render.renders, config.sensors.modalities))
    for each in found:
        check_suits(each, modalities, {c.name for c in cameras if c.fisheye is not None})
    return [each.name for each in found]


def _export(place: StoragePlace, formats: Sequence[str]) -> None:
    """Write exports anew, of the finished worlds."""
    if not formats:
        return
    from oaisys_dataset.formats.base import ExportOptions
    from oaisys_dataset.places import open_place
    from oaisys_dataset.reader import open_dataset

    dataset = open_dataset(place.url)
    for name in formats if dataset.worlds else ():
        target = export_place(place.url, name)
        open_place(target).clear()
        write_export(dataset, name, target, ExportOptions())
