"""What ``oaisys render`` writes where its command line says nothing else."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from oaisys_core.config.section import Section


class OutputConfig(Section):
    """What ``oaisys render`` renders and writes; its command line comes before.

    Attributes:
        folder: Where to write, relative to where the command runs; None: ``--out`` must say.
        batches: Worlds to build.
        samples: Views of each world.
        batch_offset: Added to the numbers of batch folders; the worlds are the same.
        save_blend: Whether each batch's world is saved as a .blend file.
    """

    folder: Path | None = None
    batches: int = Field(default=1, ge=1)
    samples: int = Field(default=1, ge=1)
    batch_offset: int = Field(default=0, ge=0)
    save_blend: bool = False
