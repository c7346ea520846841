"""Independent random streams derived from one root seed."""

from __future__ import annotations

import hashlib

import numpy as np


def batch_seed(root_seed: int, batch_id: int) -> int:
    """Return the seed of a batch, a number below 2**63 that depends on both arguments."""
    words = np.random.SeedSequence([root_seed, batch_id]).generate_state(1, np.uint64)
    return int(words[0] >> np.uint64(1))


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """Return the generator of a module's draws.

    Streams of different names or indices are independent, so that adding a module does not
    reshuffle what the others draw.

    Args:
        seed: Seed of the batch.
        name: Name of the module.
        index: 0 for the batch itself, the sample's id for what a sample draws.
    """
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
    return np.random.default_rng(np.random.SeedSequence([seed, key, index]))


def child(rng: np.random.Generator, name: str) -> np.random.Generator:
    """Return the generator of one of several things that are drawn with ``rng``.

    It depends on what ``rng`` was seeded with, not on what has been drawn from it, so that adding
    or removing a thing does not reshuffle the others.
    """
    seeds = rng.bit_generator.seed_seq
    words = seeds.generate_state(1, np.uint64)
    return stream(int(words[0] >> np.uint64(1)), name)
