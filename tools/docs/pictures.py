"""Makes the tutorials' pictures by running them: `python -m tools.docs.pictures [NUMBER ...]`.

They are docs/tutorials/NAME.webp. Without a number, all tutorials that write a picture are run.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from tools.docs.tutorial_pages import EXAMPLES, PICTURES

OPTION = '"--out"'
WIDTH_PX = 960
TIMEOUT_S = 1200.0


def main() -> None:
    """Run the tutorials that the command line names by number, or all."""
    files = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
    wanted = {int(number) for number in sys.argv[1:]} or {int(file.name[:2]) for file in files}
    for file in files:
        if int(file.name[:2]) in wanted and OPTION in file.read_text(encoding="utf-8"):
            make_picture(file)


def make_picture(example: Path) -> Path:
    """Run an example, and return the picture that it wrote, as WebP beside the others.

    Raises:
        subprocess.CalledProcessError: The example failed.
    """
    PICTURES.mkdir(parents=True, exist_ok=True)
    target = PICTURES / f"{example.stem}.webp"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "picture.png")
        command = [sys.executable, "-P", str(example), "--out", str(out)]
        subprocess.run(command, cwd=folder, check=True, timeout=TIMEOUT_S)
        with Image.open(out) as picture:
            picture.thumbnail((WIDTH_PX, WIDTH_PX))
            picture.convert("RGB").save(target, quality=80, method=6)
    return target


if __name__ == "__main__":
    main()
