"""Options of commands that serve a page."""

from __future__ import annotations

from typing import Annotated

import typer

HostOption = Annotated[
    str,
    typer.Option(
        help="Address of the page; 0.0.0.0: reachable from the network, without encryption."
    ),
]
PortOption = Annotated[int, typer.Option(help="Port of the page; 0: a free one.", min=0)]
