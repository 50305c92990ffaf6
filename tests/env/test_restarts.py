"""Restarts: moments before a fall come back bit for bit, as often as declared, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from helpers.batches import actions, assert_same, ended, play
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.variation import MOST_WAITING, REMEMBER_EVERY, RestartConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.restarts import Restarts
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

SEED = 5
DECLARED = {"fraction": 0.7, "before": [5, 15], "per_fall": 2, "episode_steps": 30}


def task(name: str = "parkour", **restarts: Any) -> TaskConfig:
    """Without curriculum, so that the first episode meets every mode."""
    return load_task(name, {"curriculum": None, "restarts": restarts or None})


def remembering(**changes: Any) -> Restarts:
    """One environment with moments of one number, which is the step they were kept at."""
    config = RestartConfig(**{"fraction": 0.5, "before": Range(10, 30), "per_fall": 3, **changes})
    restarts = Restarts(config, 1, 1)
    restarts.seed_row(0, np.random.default_rng(0))
    return restarts


def live(restarts: Restarts, steps: int) -> None:
    """An episode that lays a mode at every step and then falls."""
    row = np.zeros(1, dtype=int)
    for step in range(1, steps + 1):
        if len(restarts.due(np.array([step]))):
            restarts.remember(row, np.array([step]), np.array([[float(step)]]), np.array([step]))
    restarts.fallen(0, steps, [["mode", {"n": i}] for i in range(steps)])


def taken(restarts: Restarts, tries: int = 200) -> list[tuple[float, int]]:
    """Moments that begin episodes, and how many modes each comes with."""
    found = [moment for _ in range(tries) if (moment := restarts.take(0))]
    return [(float(vector[0]), len(modes)) for vector, modes in found]


# ---- what a task declares ----


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fraction": 0.0}, "'fraction' must be above 0 and below 1, found 0"),
        ({"fraction": 1.0}, "'fraction' must be above 0 and below 1, found 1"),
        ({"before": [2, 10]}, "'before' must be control steps from 5 to 1000"),
        ({"before": [15, 1e9]}, "'before' must be control steps from 5 to 1000"),
        ({"per_fall": 0}, "'per_fall' must be at least 1"),
        ({"per_fall": MOST_WAITING + 1}, f"'per_fall' must be at least 1 and at most {MOST_WAITING}"),
        ({"episode_steps": 0}, "'episode_steps' must be at least 1"),
        ({"befor": [5, 10]}, "befor"),
    ],
)
def test_a_mistake_is_one_sentence(changes: dict[str, Any], message: str) -> None:
    with pytest.raises((ValueError, KeyError), match=message):
        task(**{**DECLARED, **changes})


def test_the_test_protocol_has_none() -> None:
    assert task(**DECLARED).for_evaluation().restarts is None


# ---- the memory ----


def test_a_fall_lets_moments_wait_that_lie_as_far_before_it_as_declared() -> None:
    restarts, found = remembering(), []
    for _ in range(50):
        live(restarts, 83)
        found += taken(restarts)
    steps = np.array([step for step, _ in found])
    assert len(found) == 50 * 3
    assert (steps % REMEMBER_EVERY == 0).all()
    # rounded down to a moment that was kept
    assert (83 - steps >= 10).all()
    assert (83 - steps < 30 + REMEMBER_EVERY).all()
    assert len(np.unique(steps)) == 5


def test_a_moment_comes_with_the_modes_laid_until_then() -> None:
    restarts = remembering()
    live(restarts, 60)
    assert all(modes == step for step, modes in taken(restarts))


def test_nothing_waits_for_an_episode_too_short_or_of_before_it() -> None:
    restarts = remembering()
    live(restarts, 12)
    assert not taken(restarts)
    live(restarts, 60)
    taken(restarts)
    live(restarts, 24)
    assert {step for step, _ in taken(restarts)} <= {5.0, 10.0}


def test_the_queue_keeps_the_last_falls_oldest_first() -> None:
    restarts = remembering()
    for steps in (100, 200, 300):
        live(restarts, steps)
    assert [step // 100 for step, _ in taken(restarts)] == [1, 1, 1, 2, 2, 2]  # of the last two


def test_the_share_is_the_fraction_while_moments_wait() -> None:
    restarts, begun = remembering(fraction=0.3, per_fall=6), []
    for _ in range(400):
        live(restarts, 60)
        begun.append(restarts.take(0) is not None)
    assert np.mean(begun) == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / 400))


def test_seeding_forgets() -> None:
    restarts = remembering()
    live(restarts, 60)
    restarts.seed_row(0, np.random.default_rng(1))
    assert not taken(restarts)


# ---- in the environment ----


@pytest.mark.parametrize(
    ("name", "horizon", "latency"),
    [("parkour", 30, None), ("parkour", 5, None), ("dive", None, None), ("parkour", 30, [0.0, 0.1])],
)
def test_an_episode_goes_on_from_the_moment_bit_for_bit(name: str, horizon: int | None, latency: Any) -> None:
    """With a horizon of 5, every moment is one at which the oracle is asked; with latency, targets are under way."""
    overrides = {
        "curriculum": None,
        "restarts": {**DECLARED, "fraction": 0.99},
        "randomisation": latency and {"action_delay": {"delay": latency}},
    }
    declared = replace(load_task(name, overrides), horizon=horizon)
    env, commands = BatchEnv(declared, 1, SEED, threads=1), actions(2000, 1, scale=0.1)
    observation, first, begun = env.reset(), [], 0
    for command in commands:
        result = env.step(command)
        row = {"state": result.view.state, "observation": result.observation, "reward": result.reward}
        row |= {"reference": result.view.reference, "terrain": env.terrain}
        first.append({key: value.copy() for key, value in row.items()} | {"command": command})
        if len(ended(result)):
            fell_from_start = not env.restarted[0]
            observation = env.reset()
            if env.restarted[0]:
                begun += 1
                if fell_from_start:
                    path = first
                at = next(i for i, step in enumerate(path) if (step["observation"] == observation).all())
                np.testing.assert_array_equal(env.view().state, path[at]["state"])
                np.testing.assert_array_equal(env.terrain, path[at]["terrain"])
                for step in path[at + 1 : at + 4]:
                    again = env.step(step["command"])
                    for key in ("observation", "reward"):
                        np.testing.assert_array_equal(getattr(again, key), step[key])
                    np.testing.assert_array_equal(again.view.reference, step["reference"])
                    if len(ended(again)):
                        break
                env.reset()
            first = []
        if begun >= 3:
            return
    raise AssertionError("no episode began before a fall")


def test_four_rows_equal_four_environments_of_one() -> None:
    commands = actions(150, 4, scale=0.1)
    four = play(BatchEnv(task(**DECLARED), 4, SEED, threads=1), commands)
    for row in range(4):
        one = play(BatchEnv(task(**DECLARED), 1, SEED + row, threads=1), commands[:, row : row + 1])
        assert_same(one, four, rows=[row])


def test_a_saved_state_goes_on_bit_for_bit_in_another_environment() -> None:
    commands, config = actions(160, 3, scale=0.1), task(**DECLARED)
    env, other = BatchEnv(config, 3, SEED, threads=1), BatchEnv(config, 3, 77, threads=1)
    env.reset()
    other.reset()
    begun = 0
    for step, command in enumerate(commands):
        if step == 80:
            other.set_state(*env.state())
        result = env.step(command)
        rows = ended(result)
        first = env.reset(rows) if len(rows) else None
        if step >= 80:
            again = other.step(command)
            for field in ("observation", "reward", "termination"):
                np.testing.assert_array_equal(getattr(again, field), getattr(result, field))
            if first is not None:
                np.testing.assert_array_equal(other.reset(rows), first)
                np.testing.assert_array_equal(other.restarted, env.restarted)
                begun += int(env.restarted[rows].sum())
    assert begun > 0


def test_a_state_saved_without_restarts_does_not_fit_a_task_that_has_them() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        BatchEnv(task(**DECLARED), 1, SEED, threads=1).set_state(*BatchEnv(task(), 1, SEED, threads=1).state())


def test_restarted_episodes_have_their_own_time_limit_and_name_and_move_no_level() -> None:
    config = load_task("parkour", {"restarts": {**DECLARED, "fraction": 0.9}, "rho": None})
    vec = OgmpVecEnv(config, 4, SEED, threads=1)
    vec.reset()
    vec.batch.level[:] = 0.5
    found = 0
    for command in actions(300, 4, scale=0.02):
        levels, restarted = vec.batch.level.copy(), vec.batch.restarted.copy()
        _, _, dones, infos = vec.step(command)
        for row in np.flatnonzero(dones):
            assert ("restart" in infos[row]) == restarted[row]
            assert ("episode" in infos[row]) != restarted[row]
            if restarted[row]:
                found += 1
                assert infos[row]["restart"]["l"] <= 30
                assert vec.batch.level[row] == levels[row]
    assert found > 3
