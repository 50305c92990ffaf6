"""Many environments of a task as one ``VectorEnv`` of Gymnasium."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers.vector import NormalizeObservation, NormalizeReward, RecordEpisodeStatistics

import ogmp_sb3
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.sb3.gym_env import OgmpEnv
from ogmp_sb3.sb3.gym_vector_env import OgmpVectorEnv

TASKS = sorted(path.stem for path in TASKS_DIR.glob("*.yaml"))
ENVS, STEPS, SEED = 4, 30, 3
SHORT: dict[str, Any] = {"episode_steps": 12, "min_step_reward": None, "rho": 0.2}  # holds ends of every kind


def gym_id(task: str) -> str:
    return f"OGMP/{task.title().replace('_', '')}-v0"


def make(task: str = "parkour", num_envs: int = ENVS, **arguments: Any) -> OgmpVectorEnv:
    arguments = {**SHORT, **arguments}
    return gymnasium.make_vec(gym_id(task), num_envs, "vector_entry_point", threads=1, **arguments).unwrapped


def actions(env: VectorEnv, steps: int = STEPS) -> np.ndarray:
    """Actions of several steps, shape (steps, num_envs, joints)."""
    return np.random.default_rng(0).uniform(-1, 1, (steps, *env.action_space.shape))


def check_same(one: Any, other: Any) -> None:
    """Bit for bit, through mappings and arrays of arrays."""
    if isinstance(one, dict):
        assert set(one) == set(other)
        for key in one:
            check_same(one[key], other[key])
    elif isinstance(one, tuple | list) or (isinstance(one, np.ndarray) and one.dtype == object):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            check_same(a, b)
    else:
        np.testing.assert_array_equal(one, other)
        assert np.asarray(one).dtype.kind == np.asarray(other).dtype.kind


@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_makes_a_batched_environment_of_every_registered_task(task: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make_vec(gym_id(task), num_envs=2, vectorization_mode="vector_entry_point")
    assert isinstance(env, OgmpVectorEnv)
    assert (env.num_envs, env.batch.task.name) == (2, task)
    single = gymnasium.make(gym_id(task))
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space
    assert env.observation_space.shape == (2, *single.observation_space.shape)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, infos = env.reset(seed=0)
    assert observation in env.observation_space
    assert infos == {}


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("task", ["parkour", "parkour_robot"])
def test_it_is_gymnasium_s_own_vector_of_single_environments_bit_for_bit(task: str, mode: AutoresetMode) -> None:
    """With a curriculum, restarts and, in the task of a robot, disturbances: whatever an environment draws."""
    ours = make(task, autoreset_mode=mode)
    sync = SyncVectorEnv([lambda: OgmpEnv(task, **SHORT)] * ENVS, autoreset_mode=mode)
    check_same(ours.reset(seed=SEED), sync.reset(seed=SEED))
    ends = 0
    for action in actions(ours):
        results = ours.step(action)
        check_same(results, sync.step(action))
        done = results[2] | results[3]
        ends += done.sum()
        if mode == AutoresetMode.DISABLED and done.any():
            check_same(ours.reset(options={"reset_mask": done}), sync.reset(options={"reset_mask": done}))
    assert ends >= 2 * ENVS
    check_same(ours.reset(seed=[5, None, 7, 1]), sync.reset(seed=[5, None, 7, 1]))


def test_rows_are_those_of_the_sb3_environments_with_the_same_seeds() -> None:
    ours, sb3 = make(), ogmp_sb3.make_env("parkour", num_envs=ENVS, seed=SEED, **SHORT)
    np.testing.assert_array_equal(ours.reset(seed=SEED)[0], sb3.reset())
    for action in actions(ours):
        observation, reward, terminated, truncated, infos = ours.step(action)
        there, rewards, dones, rows = sb3.step(action)
        np.testing.assert_array_equal(observation, there)
        np.testing.assert_array_equal(reward.astype(np.float32), rewards)
        np.testing.assert_array_equal(terminated | truncated, dones)
        np.testing.assert_array_equal(truncated, [row["TimeLimit.truncated"] for row in rows])
        for row in np.flatnonzero(dones):
            np.testing.assert_array_equal(infos["final_obs"][row], rows[row]["terminal_observation"])
            assert infos["final_info"]["termination"][row] == rows[row]["termination"]


def test_every_environment_waiting_at_once_begins_anew_in_the_next_step() -> None:
    env = make(autoreset_mode="NextStep", episode_steps=2, rho=None, terminations={"fall": None})
    env.reset(seed=0)
    ends = [env.step(np.zeros(env.action_space.shape))[1:4:2] for _ in range(6)]
    assert [end[1].all() for end in ends] == [False, True, False] * 2
    assert [bool(end[0].any()) for end in ends] == [True, True, False] * 2


def test_what_reset_gives_stays_as_it_is_and_an_unseeded_reset_goes_on() -> None:
    env = make()
    first, _ = env.reset(seed=SEED)
    kept = first.copy()
    env.step(actions(env)[0])
    env.reset()
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(env.reset(seed=SEED)[0], kept)


def test_overrides_and_other_tasks_are_arguments() -> None:
    env = make(rho=0.07, oracle="lqr")
    assert (env.batch.task.rho, env.batch.task.oracle) == (0.07, "lqr")
    task = ogmp_sb3.load_task("dive").for_evaluation()
    assert gymnasium.make_vec("OGMP/Parkour-v0", 2, task=task).unwrapped.batch.task is task


@pytest.mark.parametrize(("mode", "wrappers"), [("SameStep", 2), ("NextStep", 3)])
def test_gymnasium_s_vector_wrappers_go_on_top(mode: str, wrappers: int) -> None:
    """Gymnasium's normaliser of observations takes environments of the mode ``NextStep`` alone."""
    env: VectorEnv = RecordEpisodeStatistics(make(autoreset_mode=mode))
    env = NormalizeReward(env)
    if wrappers == 3:
        env = NormalizeObservation(env)
    env.reset(seed=SEED)
    rewards, lengths = [np.zeros(ENVS)], []
    plain = make(autoreset_mode=mode)
    plain.reset(seed=SEED)
    for action in actions(plain):
        observation, _, _, _, infos = env.step(action)
        assert np.isfinite(observation).all() and observation.dtype == np.float32
        rewards.append(plain.step(action)[1])
        if "episode" in infos and not lengths:
            row = int(np.flatnonzero(infos["_episode"])[0])
            lengths.append(int(infos["episode"]["l"][row]))
            assert infos["episode"]["r"][row] == pytest.approx(np.sum(rewards, axis=0)[row])
            assert lengths[0] == len(rewards) - 1
    assert lengths


def test_a_copy_goes_on_bit_for_bit() -> None:
    env = make(autoreset_mode="NextStep")
    env.reset(seed=SEED)
    for action in actions(env):
        results = env.step(action)
        if (results[2] | results[3]).any():
            break
    again = copy.deepcopy(env)
    for action in actions(env)[:5]:
        check_same(env.step(action), again.step(action))


def test_every_environment_draws_itself(opengl) -> None:
    env = make(num_envs=2, render_mode="rgb_array")
    env.reset(seed=0)
    pictures = env.render()
    assert [(picture.shape[-1], picture.dtype) for picture in pictures] == [(3, np.uint8)] * 2
    env.close()
    assert env.closed


MASK = np.array([True, False])
WRONG: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"seed": [1]}, ValueError, "'seed' must be one number, or 2 of them, found 1"),
    ({"options": {"reset_masks": MASK}}, KeyError, "unknown option 'reset_masks' .* Did you mean 'reset_mask'"),
    ({"options": {"reset_mask": [True, False]}}, TypeError, "must be an array of bool, found the list"),
    ({"options": {"reset_mask": np.array([0, 1])}}, TypeError, "must be an array of bool"),
    ({"options": {"reset_mask": MASK[:1]}}, ValueError, r"must be of shape \(2,\), found \(1,\)"),
    ({"options": {"reset_mask": ~MASK & MASK}}, ValueError, "names no environment"),
    ({"options": {"reset_mask": MASK}}, ValueError, "none has been reset yet"),
    ({"seed": -3}, Exception, "at least 0|greater or equal to zero"),
]


@pytest.mark.parametrize(("arguments", "error", "message"), WRONG)
def test_a_wrong_reset_is_told_in_a_sentence(arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make(num_envs=2).reset(**arguments)


def test_wrong_arguments_are_told_in_a_sentence() -> None:
    with pytest.raises(ValueError, match=r"unknown autoreset mode 'SameSteps' .* Did you mean 'SameStep'"):
        make(autoreset_mode="SameSteps")
    with pytest.raises(ValueError, match="unknown render mode 'human'"):
        make(render_mode="human")
    with pytest.raises(ValueError, match="'num_envs' must be at least 1"):
        make(num_envs=0)
    with pytest.raises(KeyError, match="'rhoo'"):
        make(rhoo=1)
    with pytest.raises(ResetNeeded, match="must be reset before their first step"):
        make().step(np.zeros((ENVS, 10)))


def test_an_episode_that_ended_must_be_reset_where_nothing_else_does() -> None:
    env = make(num_envs=2, autoreset_mode=AutoresetMode.DISABLED, episode_steps=1, terminations={"fall": None})
    env.reset(seed=0)
    env.step(np.zeros((2, 10)))
    env.reset(options={"reset_mask": MASK})
    with pytest.raises(ResetNeeded, match="episodes of environments 1 have ended"):
        env.step(np.zeros((2, 10)))
