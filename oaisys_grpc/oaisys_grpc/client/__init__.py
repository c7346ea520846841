"""A typed client of the simulator: the core's types and errors, without Blender or protobuf."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oaisys_grpc.client.simulator_client import (
        DEFAULT_ADDRESS,
        ClientTls,
        DriveStream,
        SampleStream,
        SimulatorClient,
    )

__all__ = ["DEFAULT_ADDRESS", "ClientTls", "DriveStream", "SampleStream", "SimulatorClient"]


def __getattr__(name: str) -> Any:
    """Import gRPC when the client is used: `oaisys --help` imports a module of this folder."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from oaisys_grpc.client import simulator_client

    return getattr(simulator_client, name)
