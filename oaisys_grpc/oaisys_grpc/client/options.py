"""Options of the shell commands that connect to a server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

TlsCaOption = Annotated[
    Path | None,
    typer.Option(help="Certificate authorities (PEM) of a server that encrypts."),
]
TlsCertOption = Annotated[
    Path | None,
    typer.Option(help="Certificate (PEM) of this client, where the server asks for one."),
]
TlsKeyOption = Annotated[Path | None, typer.Option(help="Private key of that certificate.")]
