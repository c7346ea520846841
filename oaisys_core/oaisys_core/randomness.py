"""Independent random streams derived from one root seed."""

from __future__ import annotations

import hashlib

import numpy as np


def batch_seed(root_seed: int, batch_id: int) -> int:
    """Return the seed of a batch, a number below 2**63."""
    words = np.random.SeedSequence([root_seed, batch_id]).generate_state(1, np.uint64)
    return int(words[0] >> np.uint64(1))


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """Return the random generator of a module.

    Streams with different names or indices are independent, so that adding a module does not
    change what the others draw.

    Args:
        seed: Seed of the batch.
        name: Name of the module.
        index: 0 for the batch itself, otherwise the id of the sample.
    """
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
    return np.random.default_rng(np.random.SeedSequence([seed, key, index]))


def child(rng: np.random.Generator, name: str) -> np.random.Generator:
    """Return the generator of one of several objects that are drawn with ``rng``.

    It depends on the seed of ``rng``, not on what has been drawn from it, so that adding or
    removing an object does not change the others.
    """
    seeds = rng.bit_generator.seed_seq
    words = seeds.generate_state(1, np.uint64)
    return stream(int(words[0] >> np.uint64(1)), name)
