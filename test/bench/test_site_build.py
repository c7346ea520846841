"""The documentation site builds strictly."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from repository import REPOSITORY


def test_the_site_builds_strictly(tmp_path: Path) -> None:
    folder = Path(sys.prefix) / "docs"
    command = [str(REPOSITORY / "tools" / "docs.sh"), str(folder), "build", "--strict", "--quiet"]
    built = subprocess.run(
        [*command, "--site-dir", str(tmp_path / "site")],
        env={**os.environ, "PIP_NO_INPUT": "1"},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert built.returncode == 0, built.stderr + built.stdout
    page = (tmp_path / "site" / "reference" / "api" / "simulation" / "index.html").read_text()
    assert "step_sample" in page
    assert not re.search(r"googleapis|data-md-component=.source", page), (
        "nothing is fetched from elsewhere"
    )
