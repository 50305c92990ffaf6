"""The guide alone: robots that are wherever a test puts them, and no simulator."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from ogmp_sb3 import load_task
from ogmp_sb3.env import snapshots
from ogmp_sb3.guidance.guide import Guide
from ogmp_sb3.guidance.srb import POS, STATE_SIZE, VEL

ENVS = 3
STEADY = {"modes": {"pace": {"v": 0.8, "length": 1.0}, "jump": None, "leap": None}, "curriculum": None}


def begun(task: str = "parkour", **overrides) -> tuple[Guide, list[np.random.Generator], np.ndarray]:
    """A guide at the start of an episode, the generators, and the states it was asked from."""
    guide = Guide(load_task(task, overrides), ENVS)
    generators = [np.random.default_rng(row) for row in range(ENVS)]
    states = np.zeros((ENVS, STATE_SIZE))
    for row in range(ENVS):
        states[row, POS.start + 2] = guide.begin(row, generators[row], 1.0) + 0.5
    guide.query(np.arange(ENVS), states)
    return guide, generators, states


def follow(guide: Guide, generators: list[np.random.Generator], states: np.ndarray) -> np.ndarray:
    """One control step; returns the environments whose terrain has changed."""
    guide.advance()
    every = np.arange(ENVS)
    return guide.follow(every, states[:, POS.start], lambda rows: states[rows], generators, np.ones(ENVS))


def test_a_reference_is_followed_knot_by_knot_and_the_oracle_asked_again_at_its_end() -> None:
    guide, generators, states = begun(**STEADY)
    horizon = load_task("parkour").horizon
    assert horizon is not None
    np.testing.assert_array_equal(guide.knots(np.arange(ENVS), states[:, POS.start]).reference[:, POS], states[:, POS])
    for step in range(1, horizon):
        follow(guide, generators, states)
        knots = guide.knots(np.array([1]), states[1:2, POS.start])
        assert (knots.phase[0], knots.period[0]) == (step, horizon)
        np.testing.assert_array_equal(knots.reference[0], guide.plan(1)[step])
    states = states.copy()
    states[:, POS.start] += 0.7
    states[:, VEL.start] = 0.8
    follow(guide, generators, states)
    assert (guide.knots(np.arange(ENVS), states[:, POS.start]).phase == 0).all()
    np.testing.assert_array_equal(guide.plan(2)[0, POS], states[2, POS])


def test_the_track_is_laid_ahead_of_those_robots_alone_that_have_moved_on() -> None:
    guide, generators, states = begun(**STEADY)
    modes = [len(calls) for calls in guide.modes]
    assert not len(follow(guide, generators, states))
    states = states.copy()
    states[1, POS.start] = 1.5
    assert follow(guide, generators, states).tolist() == [1]
    assert [len(calls) > before for calls, before in zip(guide.modes, modes, strict=True)] == [False, True, False]


def test_a_timed_mode_is_followed_by_the_next_one() -> None:
    guide, generators, states = begun("dive")
    steps = int(guide.knots(np.array([0]), states[:1, POS.start]).period[0])
    assert guide.timed and guide.mode_at(0, 0.0).name == "flip"
    for _ in range(steps):
        follow(guide, generators, states)
    assert guide.mode_at(0, 0.0).name == "settle"


def test_a_state_that_was_saved_goes_on_as_it_would_have() -> None:
    guide, generators, states = begun()
    states = states.copy()
    for step in range(40):
        states[:, POS.start] = 0.03 * step
        follow(guide, generators, states)
    arrays, plain = snapshots.take(guide.arrays()), copy.deepcopy(guide.plain())
    other, _, _ = begun()
    snapshots.put_back(other.arrays(), arrays)
    other.set_plain(plain)
    twins = copy.deepcopy(generators)
    for step in range(40, 80):
        states[:, POS.start] = 0.03 * step
        follow(guide, generators, states)
        follow(other, twins, states)
    for name, values in guide.arrays().items():
        np.testing.assert_array_equal(values, other.arrays()[name], err_msg=name)
    assert guide.plain() == other.plain()


def test_a_command_comes_before_drawn_modes_and_can_be_forgotten() -> None:
    guide, generators, _ = begun()
    guide.command(0, "jump", {"h": 0.11}, generators[0])
    guide.command(1, "jump", {"h": 0.11}, generators[1])
    guide.forget_commands(1)
    before = [len(calls) for calls in guide.modes]
    for row in range(ENVS):
        guide.course.extend(row, 3.0, generators[row], 1.0)
    commanded = [calls[n].parameters.get("h") == 0.11 for calls, n in zip(guide.modes, before, strict=True)]
    assert commanded == [True, False, False]
    with pytest.raises(KeyError, match=r"the task has no mode 'jmp'.*Did you mean 'jump'"):
        guide.command(0, "jmp", {}, generators[0])
