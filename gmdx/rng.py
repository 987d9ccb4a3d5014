"""Random numbers by key: no generator is shared, so order and batching change nothing."""

import hashlib

import numpy as np


def generator(seed: int, *path: str | int) -> np.random.Generator:
    """A generator that depends only on `seed` and on the path of names and numbers.

    The same key gives the same numbers whatever was drawn before, in which order,
    in which process: `generator(0, "mug", scene, grasp, "trial", 3)`.

    Args:
        seed: The run's seed.
        path: What the numbers are for, from the general to the particular.
    """
    text = "\x1f".join([str(int(seed)), *(f"{type(p).__name__}:{p}" for p in path)])
    digest = hashlib.blake2b(text.encode(), digest_size=32).digest()
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(list(digest))))
