"""Streams of random numbers: training, test and selection have their own, so that one seed gives each other tracks."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from ogmp_sb3.config.messages import did_you_mean

Stream = Literal["training", "test", "selection"]
"""What episodes are for: to train a policy; to report how good it is; or to choose between policies or settings."""


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """The generator that an environment draws all its randomness from.

    :param seed: at least 0
    :param stream: what the episodes are for
    :raises ValueError: for a negative seed, or an unknown stream
    """
    if seed < 0:
        raise ValueError(f"'seed' must be at least 0, found {seed}.")
    if stream not in get_args(Stream):
        raise ValueError(f"unknown stream {stream!r}{did_you_mean(str(stream), get_args(Stream))}")
    if stream == "training":
        return np.random.default_rng(seed)
    # The children that a generator spawns are numbered from 0: a word is no such number.
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int.from_bytes(stream.encode(), "big"),)))
