"""three.js, with which reports show the mesh."""

from __future__ import annotations

import os
import shutil

from tools.setup.environment import Environment
from tools.setup.errors import OptionalStepError
from tools.setup.programs import Programs

THREE_VERSION = "0.183.2"
"""The last version with minified modules."""

NPM_TIMEOUT_S = 120.0


def install_three(environment: Environment, programs: Programs) -> None:
    """Install three.js to ``share/oaisys_mapping``, where reports find it.

    Raises:
        OptionalStepError: npm is missing or failed; reports then show pictures of the mesh.
    """
    without = "reports will show pictures of the mesh instead of an interactive view"
    npm = shutil.which("npm")
    if npm is None:
        raise OptionalStepError(f"three.js needs npm, and there is none: {without}")
    folder = environment.root / "share" / "oaisys_mapping"
    folder.mkdir(parents=True, exist_ok=True)
    # Do not retry failed downloads for minutes.
    command = [npm, "install", "--prefix", str(folder), "--no-save", "--no-package-lock"]
    command += ["--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=1"]
    command.append(f"three@{THREE_VERSION}")
    log = environment.state / "npm.log"
    code = programs.run(command, os.environ, log, timeout_s=NPM_TIMEOUT_S)
    if code:
        raise OptionalStepError(f"npm failed, its output is in {log}: {without}")
