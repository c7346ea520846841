"""Makes the tutorials' pictures by running them: `python -m tools.docs.pictures [NUMBER ...]`.

They are docs/tutorials/NAME.webp. Without a number, all tutorials are run.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from PIL import Image

from tools.docs.picture_runs import RUNS, run_with_out
from tools.docs.tutorial_pages import EXAMPLES, PICTURES

WIDTH_PX = 960
LEAST_WIDTH_PX = 480
MOST_BYTES = 60_000


def main() -> None:
    """Run the tutorials that the command line names by number, or all."""
    files = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
    numbers = {int(file.name[:2]) for file in files}
    parser = argparse.ArgumentParser(prog="python -m tools.docs.pictures", description=__doc__)
    parser.add_argument("numbers", nargs="*", type=int, metavar="NUMBER")
    wanted = set(parser.parse_args().numbers)
    if unknown := wanted - numbers:
        parser.error(f"NUMBER: received {min(unknown)}, expected one from 1 to {max(numbers)}")
    wanted = wanted or numbers
    for file in files:
        if int(file.name[:2]) in wanted:
            print(make_picture(file), flush=True)


def make_picture(example: Path) -> Path:
    """Run an example, and return the picture that it makes, as WebP beside the others.

    Raises:
        subprocess.CalledProcessError: The example failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        run = RUNS.get(example.stem, run_with_out)
        with Image.open(run(example, Path(folder))) as picture:
            return write_webp(picture, PICTURES / f"{example.stem}.webp")


def write_webp(picture: Image.Image, target: Path) -> Path:
    """Write a picture for a page, coarser until it has at most `MOST_BYTES`."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if picture.width < LEAST_WIDTH_PX:  # pictures of an agent's eyes: their pixels stay squares
        factor = -(-LEAST_WIDTH_PX // picture.width)
        size_px = (factor * picture.width, factor * picture.height)
        picture = picture.resize(size_px, Image.Resampling.NEAREST)
    picture.thumbnail((WIDTH_PX, WIDTH_PX))
    for quality in range(80, 20, -10):
        picture.convert("RGB").save(target, quality=quality, method=6)
        if target.stat().st_size <= MOST_BYTES:
            break
    return target


if __name__ == "__main__":
    main()
