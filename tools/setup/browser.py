"""The JavaScript that pages need: three.js, from npm, into the environment."""

from __future__ import annotations

import shutil
import subprocess

from tools.setup.errors import OptionalStepError
from tools.setup.paths import Environment

THREE_VERSION = "0.183.2"
"""The last that brings minified modules."""

TIMEOUT_S = 120.0


def install_three(environment: Environment) -> None:
    """Install three.js to ``share/oaisys_mapping``, where reports find it.

    Raises:
        OptionalStepError: There is no npm, or it failed; reports show pictures instead.
    """
    without = "reports will show pictures of the mesh instead of one that turns"
    npm = shutil.which("npm")
    if npm is None:
        raise OptionalStepError(f"three.js needs npm, and there is none: {without}")
    folder = environment.root / "share" / "oaisys_mapping"
    folder.mkdir(parents=True, exist_ok=True)
    # What fails to be fetched is not tried for minutes.
    command = [npm, "install", "--prefix", str(folder), "--no-save", "--no-package-lock"]
    command += ["--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=1"]
    command.append(f"three@{THREE_VERSION}")
    log = environment.state / "npm.log"
    with log.open("w") as output:
        try:
            result = subprocess.run(
                command, stdout=output, stderr=output, timeout=TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            raise OptionalStepError(f"npm took more than {TIMEOUT_S:g} s: {without}") from None
    if result.returncode:
        raise OptionalStepError(f"npm failed, its output is in {log}: {without}")
