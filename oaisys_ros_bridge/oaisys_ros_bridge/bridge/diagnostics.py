"""What the bridge says about itself on ``/diagnostics``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from oaisys_core.types import SimulatorInfo

BYTES_PER_MB = 1e6

FIRST_BATCH_ERROR = "first_batch_error"
"""Key of why there is no world although the bridge tried twice; empty: no such thing."""

FIRST_BATCH_RETRIED = "first_batch_retried_after"
"""Key of what the first of these tries failed of; stays where the second one succeeds."""

SUBSCRIBERS = "subscribers "
"""Prefix of the keys that hold how many subscribers of a topic the bridge is matched with."""


def diagnostics_msg(
    name: str, hardware_id: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return one status; its stamp is the caller's to set."""
    entries = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    status = DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware_id, values=entries
    )
    return DiagnosticArray(status=[status])


def simulator_values(info: SimulatorInfo | None) -> dict[str, object]:
    """Return what is known of the simulator, by name."""
    if info is None:
        return {"connected": False}
    return {
        "connected": True,
        "backend": f"{info.backend} {info.backend_version}",
        "device": info.device,
        "batch_id": info.batch_id,
        "worker_restarts": info.worker_restarts,
    }


def resident_mb() -> float:
    """Return the memory that this process holds, in MB; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGESIZE") / BYTES_PER_MB


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.4f}" if isinstance(value, float) else str(value)
