"""How Ray finds the path of Python for its workers.

Private part: ``ray.job_config.JobConfig._runtime_env_has_working_dir``, which Ray asks before it
    puts the driver's current folder before the installed packages of its workers.
Tried with: Ray 2.60.0.
Public way without it: Ray's own configuration of a job.
Lost without it: safety of the path; files in the current folder shadow installed packages.
"""

from __future__ import annotations

from typing import Any

from oaisys_core.system.fallbacks import report_fallback

ASKED = "_runtime_env_has_working_dir"
"""Name of the method."""


def safe_path_config(ray: Any) -> Any:
    """Return how workers run: without this process's folder before their installed packages.

    None, Ray's default, if this Ray lets nobody say so.
    """
    base = getattr(getattr(ray, "job_config", None), "JobConfig", None)
    if not hasattr(base, ASKED):
        instead = "modules in the current folder shadow those that are installed for workers"
        report_fallback("Ray's path of Python", f"JobConfig has no {ASKED}", instead)
        return None

    class SafePathConfig(base):  # type: ignore[misc, valid-type]
        """Keeps Ray from adding the current folder to the path of its workers."""

        def _runtime_env_has_working_dir(self) -> bool:
            return True

    return SafePathConfig()
