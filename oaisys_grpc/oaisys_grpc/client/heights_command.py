"""``oaisys heights``: ground and surface of a world on a grid, as a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.cli.options import BackendOption, ConfigOption, SeedOption
from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import InvalidInputError
from oaisys_grpc.client.options import TlsCaOption, TlsCertOption, TlsKeyOption

if TYPE_CHECKING:
    from oaisys_core.types import Extent, HeightGrid
    from oaisys_grpc.tls import ClientTls


def heights(
    out: Annotated[
        Path, typer.Option("--out", help="File to write: .tif (GeoTIFF, two bands) or .npz.")
    ],
    resolution: Annotated[float, typer.Option(help="Edge of a cell in metres.")] = 0.1,
    extent: Annotated[
        str | None,
        typer.Option(help="min_x,min_y,max_x,max_y in map, metres; default: the whole stage."),
    ] = None,
    config: ConfigOption = None,
    seed: SeedOption = None,
    backend: BackendOption = None,
    batch: Annotated[int, typer.Option(help="Which world of the configuration.", min=1)] = 1,
    address: Annotated[
        str | None, typer.Option(help="host:port of a running server: the world that stands there.")
    ] = None,
    tls_ca: TlsCaOption = None,
    tls_cert: TlsCertOption = None,
    tls_key: TlsKeyOption = None,
) -> None:
    """Write the heights of ground and topmost surface at the centres of a grid's cells.

    Metres in the frame map, float32, NaN off the stage. Surface includes what stands on the ground.
    GeoTIFF has row 0 in the north (+y), NPZ in the south, with origin_xy_m and spacing_m.
    """
    # `oaisys --help` reads this module, too: what takes long to import waits until it is used.
    from oaisys_core.files.whole_files import check_output_file
    from oaisys_core.output.heights import SUFFIXES, write_heights
    from oaisys_grpc.tls import client_tls

    if out.suffix not in SUFFIXES:
        raise InvalidInputError("out", str(out), f"a file that ends in {', '.join(SUFFIXES)}")
    wanted = None if extent is None else _parse(extent)
    tls = client_tls(tls_ca, tls_cert, tls_key)
    check_output_file(out)
    if address is not None:
        own = {"--config": config, "--seed": seed, "--backend": backend}
        own["--batch"] = None if batch == 1 else batch
        if given := [name for name, value in own.items() if value is not None]:
            raise InvalidInputError("--address", address, f"none with {', '.join(given)}")
        grid = _request_heights(address, tls, resolution, wanted)
    elif tls is not None:
        raise InvalidInputError("address", None, "the server that the TLS options are for")
    else:
        grid = _build(config, seed, backend, batch, resolution, wanted)
    write_heights(out, grid)
    rows, columns = grid.ground_m.shape
    typer.echo(f"{out}: {columns} x {rows} cells of {grid.spacing_m:g} m")


def _request_heights(
    address: str, tls: ClientTls | None, resolution_m: float, extent_m: Extent | None
) -> HeightGrid:
    from oaisys_grpc.client.simulator_client import SimulatorClient

    with SimulatorClient(address, tls=tls) as client:
        return client.height_grid(resolution_m, extent_m)


def _build(
    config: Path | None,
    seed: int | None,
    backend: str | None,
    batch: int,
    resolution_m: float,
    extent_m: Extent | None,
) -> HeightGrid:
    from oaisys_core import randomness
    from oaisys_core.config import SimulationConfig, adjust, load_config
    from oaisys_core.simulation import Simulation
    from oaisys_core.world.height_grids import grid_shape

    # Before a world is built for a resolution that is none.
    grid_shape(resolution_m, extent_m or (0.0, 0.0, resolution_m, resolution_m))
    loaded = load_config(config) if config else SimulationConfig()
    chosen = adjust(loaded, seed=seed, backend=backend)
    with own_stdout():
        simulation = Simulation(chosen)
        try:
            simulation.step_batch(seed=randomness.batch_seed(chosen.seed, batch))
            return simulation.height_grid(resolution_m, extent_m)
        finally:
            simulation.close()


def _parse(extent: str) -> Extent:
    expected = "min_x,min_y,max_x,max_y in metres, such as -5,-5,5,5"
    try:
        x0, y0, x1, y1 = (float(part) for part in extent.split(","))
    except ValueError as error:
        raise InvalidInputError("extent", extent, expected) from error
    return (x0, y0, x1, y1)
