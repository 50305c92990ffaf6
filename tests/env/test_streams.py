"""Streams: a seed gives a training, a test and a selection different tracks, and each always the same."""

from __future__ import annotations

import pickle
from typing import Any, get_args

import numpy as np
import pytest

from helpers.batches import OPEN, SEED, actions, assert_same, at_full_level, play
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.streams import Stream, generator

STREAMS = get_args(Stream)
NUMBERS = 8


def numbers(rng: np.random.Generator) -> tuple[float, ...]:
    return tuple(rng.random(NUMBERS))


def test_training_draws_from_the_plain_generator_of_its_seed() -> None:
    assert numbers(generator(7, "training")) == numbers(np.random.default_rng(7))


def test_no_two_generators_of_any_stream_or_seed_or_their_children_are_the_same() -> None:
    made = [generator(seed, stream) for stream in STREAMS for seed in range(50)]
    children = [child for rng in made for child in rng.spawn(4)]
    assert len({numbers(rng) for rng in (*made, *children)}) == 5 * len(made)


@pytest.mark.parametrize("stream", STREAMS)
def test_a_generator_of_a_seed_is_always_the_same(stream: Stream) -> None:
    assert numbers(generator(3, stream)) == numbers(generator(3, stream))


@pytest.mark.parametrize(
    "seed, stream, message",
    [
        (-1, "test", r"^'seed' must be at least 0, found -1\.$"),
        (0, "tset", r"^unknown stream 'tset' \(allowed: selection, test, training\)\. Did you mean 'test'\?$"),
    ],
)
def test_a_wrong_seed_or_stream_is_one_sentence(seed: int, stream: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        generator(seed, stream)


def test_the_same_seed_lays_another_track_in_each_stream() -> None:
    task = at_full_level(load_task("parkour", OPEN))
    envs = [BatchEnv(task, 2, SEED, threads=1, stream=stream) for stream in STREAMS]
    for env in envs:
        env.reset()
    tracks = {repr(env.modes[row]) for env in envs for row in range(2)}
    assert len(tracks) == 2 * len(STREAMS)


@pytest.mark.parametrize("stream", ["test", "selection"])
def test_four_rows_equal_four_environments_of_one_in_every_stream(stream: Stream) -> None:
    task, commands = load_task("parkour").for_evaluation(), actions(20, 4)
    four = play(BatchEnv(task, 4, SEED, 1, stream), commands)
    for row in range(4):
        assert_same(play(BatchEnv(task, 1, SEED + row, 1, stream), commands[:, [row]]), four, rows=[row])


def test_a_copy_stays_in_its_stream() -> None:
    env = BatchEnv(at_full_level(load_task("parkour", OPEN)), 1, SEED, threads=1, stream="test")
    copy = pickle.loads(pickle.dumps(env))
    for each in (env, copy):
        each.seed(11)
        each.reset()
    assert repr(copy.modes) == repr(env.modes)
