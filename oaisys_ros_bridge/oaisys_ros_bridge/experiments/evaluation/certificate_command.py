"""The shell command ``oaisys certificate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.experiments.options import KeyOption, WorkerPythonOption
from oaisys_ros_bridge.experiments.survey.command import survey

certificate_app = typer.Typer(
    help="Certify that a world's map agrees with it, and check certificates.",
    no_args_is_help=True,
    add_completion=False,
)
certificate_app.command("issue", help="Survey a world and certify it; the same as oaisys survey.")(
    survey
)


@certificate_app.command("check")
def check(
    file: Annotated[Path, typer.Argument(help="The file certificate.json.")],
    mesh: Annotated[
        Path | None, typer.Option(help="The map's mesh; otherwise the one beside the certificate.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="The true mesh; otherwise the one beside the certificate.")
    ] = None,
    public_key: Annotated[
        Path | None, typer.Option(help="PEM file of the Ed25519 key that must have signed it.")
    ] = None,
    render_again: Annotated[
        bool, typer.Option("--render-again", help="Render and map the views again, too.")
    ] = False,
    allow_loosened: Annotated[
        bool, typer.Option("--allow-loosened", help="Accept limits looser than the default ones.")
    ] = False,
    worker_python: WorkerPythonOption = None,
) -> None:
    """Check a certificate: hash, signature, limits and files, and measure its figures again.

    Exit 0 if everything holds and the map agrees with the true surface, 1 if not, 2 if it is no
    certificate.
    """
    from oaisys_mapping.certificate.certificate import CLOSED, read_certificate
    from oaisys_mapping.certificate.signature import read_public_key
    from oaisys_mapping.certificate.verification import check_content, check_limits

    certificate = read_certificate(file)
    signer = None if public_key is None else read_public_key(public_key)
    findings = check_content(certificate, signer)
    content = certificate["content"]
    findings += check_limits(content, allow_loosened=allow_loosened)
    findings += _measure_again(content, file.parent, mesh, truth)
    if render_again:
        from oaisys_ros_bridge.experiments.evaluation.certificate_render import render_and_compare
        from oaisys_ros_bridge.experiments.progress import Reporter

        findings += render_and_compare(content, worker_python, Reporter())
    for finding in findings:
        typer.echo(str(finding))
    holds = all(finding.holds is not False for finding in findings)
    agrees = content.get("verdict") == CLOSED
    typer.echo("the certificate holds" if holds else "the certificate does not hold")
    if holds and not agrees:
        typer.echo("it says that the map does not agree with the true surface")
    if not (holds and agrees):
        raise typer.Exit(1)


def _measure_again(
    content: dict[str, Any], folder: Path, mesh: Path | None, truth: Path | None
) -> list[Any]:
    """Check the files that exist, and measure again if both do."""
    from oaisys_mapping.certificate.verification import CheckResult, check_file, measure_again
    from oaisys_mapping.evaluation.truth_io import read_truth
    from oaisys_mapping.mesh_io import read_ply

    paths = {}
    for what, given in (("mesh", mesh), ("truth", truth)):
        path = given or folder / str(content.get("files", {}).get(what, {}).get("name"))
        if given is not None and not given.is_file():
            raise InvalidInputError(f"--{what}", str(given), "an existing file")
        if path.is_file():
            paths[what] = path
    findings = [check_file(content, what, path) for what, path in paths.items()]
    findings += [
        CheckResult(f"the {what}, which is not beside the certificate", None)
        for what in {"mesh", "truth"} - paths.keys()
    ]
    if len(paths) == 2:
        findings += measure_again(content, read_ply(paths["mesh"]), read_truth(paths["truth"]))
    return findings


@certificate_app.command("sign")
def sign(
    file: Annotated[Path, typer.Argument(help="The file certificate.json; it is replaced.")],
    key: KeyOption,
) -> None:
    """Sign an unchanged certificate; an earlier signature is replaced."""
    from oaisys_mapping.certificate.certificate import read_certificate, sign_certificate
    from oaisys_mapping.certificate.signature import public_key_of, read_private_key

    assert key is not None
    signer = read_private_key(key)
    sign_certificate(file, read_certificate(file), signer)
    typer.echo(f"{file}: signed by {public_key_of(signer)}")


@certificate_app.command("challenge")
def challenge(
    folder: Annotated[Path, typer.Argument(help="Output folder of a survey that recorded a bag.")],
) -> None:
    """Repeat the perturbation test: map a recorded survey, without and with deliberate faults.

    Exit 0 if the map without a fault is accepted and all others are rejected.
    """
    from oaisys_ros_bridge.experiments.evaluation.bag_perturbations import perturb_bag
    from oaisys_ros_bridge.experiments.progress import Reporter, print_table
    from oaisys_ros_bridge.experiments.survey.seeds import faults_table

    records = perturb_bag(folder, Reporter())
    print_table(faults_table([record.to_dict() for record in records]))
    if any(record.is_rejected == (record.name == "none") for record in records):
        raise typer.Exit(1)
