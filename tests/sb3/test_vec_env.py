"""The environment as Stable-Baselines3 and Gymnasium see it."""

import copy
import pickle
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import stable_baselines3.common.env_checker
from stable_baselines3.common.vec_env import VecMonitor

import ogmp_sb3
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.sb3.gym_env import OgmpEnv
from ogmp_sb3.sb3.vec_env import OgmpVecEnv, make_env

TASKS = sorted(path.stem for path in TASKS_DIR.glob("*.yaml"))
SEED = 3


def actions(steps: int, num_envs: int, scale: float = 0.3) -> np.ndarray:
    """Random actions, shape (steps, num_envs, 10), float32."""
    return (scale * np.random.default_rng(0).uniform(-1, 1, (steps, num_envs, 10))).astype(np.float32)


def overrides(name: str) -> dict[str, Any]:
    """Short episodes, so that a few steps hold ends of every kind; no curriculum, so that rows differ."""
    return {"episode_steps": 12, "curriculum": None, "min_step_reward": None, "rho": 0.2}


# ---- Gymnasium ----


@pytest.mark.parametrize("name", TASKS)
def test_stable_baselines3_s_own_check_passes_without_a_warning(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stable_baselines3.common.env_checker.check_env(OgmpEnv(name), warn=True)


# ---- Stable-Baselines3 ----


@pytest.mark.parametrize("name", TASKS)
def test_four_environments_in_one_equal_four_of_one_with_automatic_resets(name: str) -> None:
    task = load_task(name, overrides(name))
    vec = OgmpVecEnv(task, num_envs=4, threads=1)
    vec.seed(SEED)
    singles = [OgmpEnv(task) for _ in range(4)]
    observation = vec.reset()
    for row, env in enumerate(singles):
        np.testing.assert_array_equal(observation[row], env.reset(seed=SEED + row)[0])
    ends = 0
    for command in actions(80, 4):
        observation, reward, done, infos = vec.step(command)
        for row, env in enumerate(singles):
            seen, single_reward, terminated, truncated, info = env.step(command[row])
            assert reward[row] == np.float32(single_reward)
            assert done[row] == (terminated or truncated)
            assert infos[row]["TimeLimit.truncated"] == truncated
            assert {key: infos[row][key] for key in info} == info
            if done[row]:
                np.testing.assert_array_equal(infos[row]["terminal_observation"], seen)
                seen, _ = env.reset()
                ends += 1
            np.testing.assert_array_equal(observation[row], seen)
    assert ends > 8


@pytest.mark.parametrize("name", TASKS)
def test_the_seed_given_at_the_start_is_the_seed_of_the_first_episode(name: str) -> None:
    """``OgmpVecEnv(seed=3)`` and ``seed(3)`` mean the same: environment i is ``OgmpEnv.reset(seed=3 + i)``."""
    task = load_task(name, overrides(name))
    given, told = OgmpVecEnv(task, 2, SEED, threads=1), OgmpVecEnv(task, 2, SEED + 50, threads=1)
    told.seed(SEED)
    given.reset(), told.reset()
    assert given.batch.modes == told.batch.modes


@pytest.mark.parametrize("name", TASKS)
def test_ends_and_what_they_tell(name: str) -> None:
    task = load_task(name, overrides(name))
    vec = OgmpVecEnv(task, num_envs=4, seed=SEED, threads=1)
    vec.reset()
    p = vec.batch.sim.base_qpos
    sums = {key: np.zeros(4) for key in ("r", "l", "deviation")}
    causes = set()
    for command in actions(300, 4, 0.1):
        observation, reward, done, infos = vec.step(command)
        assert observation.dtype == np.float32
        assert reward.dtype == np.float32
        assert done.dtype == bool
        for row, info in enumerate(infos):
            sums["r"][row] += reward[row]
            sums["l"][row] += 1
            sums["deviation"][row] += info["deviation"]
            assert ("terminal_observation" in info) == done[row]
            assert ("episode" in info) == done[row]
            assert (info["termination"] != "") == done[row]
            assert info["TimeLimit.truncated"] == (info["termination"] == "time_limit")
            assert (info["deviation"] > task.rho) == (info["termination"] == "bound")
            if not done[row]:
                continue
            causes.add(info["termination"])
            episode = info["episode"]
            assert episode["r"] == pytest.approx(sums["r"][row], abs=1e-4)
            assert episode["l"] == sums["l"][row]
            assert episode["deviation"] == pytest.approx(sums["deviation"][row] / sums["l"][row])
            terms = sum(episode[term] for term in task.rewards)
            assert terms == pytest.approx(sums["r"][row] / sums["l"][row], abs=1e-5)
            assert info["terminal_observation"].shape == vec.observation_space.shape
            assert vec.batch.sim.qpos[row, p] == 0.0  # begun anew
            assert vec.batch.step_count[row] == 0
            for total in sums.values():
                total[row] = 0.0
    assert {"bound", "time_limit"} <= causes


def test_an_episode_tells_the_distance_it_covered() -> None:
    vec = make_env("parkour", 2, rho=None, min_step_reward=None, episode_steps=5, terminations={"fall": None})
    vec.reset()
    for step in range(5):
        if step == 4:
            vec.batch.sim.qpos[1, vec.batch.sim.base_qpos] = 1.5
        _, _, done, infos = vec.step(np.zeros((2, 10)))
    assert done.all()
    assert abs(infos[0]["episode"]["distance"]) < 0.05
    assert infos[1]["episode"]["distance"] == pytest.approx(1.5, abs=0.1)


def test_an_exploding_row_leaves_no_number_that_is_not_finite_in_a_reward_or_an_episode() -> None:
    """One NaN among the logged episodes makes every mean of a training log NaN."""
    vec = make_env("parkour", 3)
    vec.reset()
    vec.step(np.zeros((3, 10)))
    vec.batch.sim.qvel[1, 2] = np.nan
    observation, reward, done, infos = vec.step(np.zeros((3, 10)))
    np.testing.assert_array_equal(done, [False, True, False])
    assert infos[1]["termination"] == "unstable"
    assert np.isfinite(observation).all()
    assert np.isfinite(reward).all()
    assert np.isfinite(infos[1]["terminal_observation"]).all()
    assert [key for key, value in infos[1]["episode"].items() if not np.isfinite(value)] == []
    assert np.isfinite(infos[0]["deviation"])
    observation, *_ = vec.step(np.zeros((3, 10)))
    assert np.isfinite(observation).all()


def test_what_was_handed_out_does_not_change_later() -> None:
    vec = make_env("parkour", 2, rho=0.05)
    kept = [vec.reset()]
    copies = [kept[0].copy()]
    for command in actions(30, 2):
        observation, reward, _, infos = vec.step(command)
        for array in (observation, reward, *(i["terminal_observation"] for i in infos if "terminal_observation" in i)):
            kept.append(array)
            copies.append(array.copy())
    for array, before in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(array, before)


def test_seeding_repeats_a_rollout_and_resetting_again_does_not() -> None:
    vec = make_env("parkour", 2, curriculum=None)
    tracks = []
    for seed in (SEED, None, SEED, SEED + 10):
        if seed is not None:
            vec.seed(seed)
        vec.reset()
        tracks.append([list(calls) for calls in vec.batch.modes])
    assert tracks[0] == tracks[2]
    assert tracks[0] != tracks[1]
    assert tracks[0] != tracks[3]
    assert tracks[0][0] != tracks[0][1]


def test_attributes_and_methods_are_reached_through_sb3_s_doors() -> None:
    vec = make_env("parkour", 3)
    assert vec.get_attr("num_envs") == [3, 3, 3]
    assert vec.get_attr("render_mode", indices=1) == [None]
    vec.set_attr("render_mode", "rgb_array")
    assert vec.get_attr("render_mode", indices=[0, 2]) == ["rgb_array", "rgb_array"]
    assert vec.env_method("env_is_wrapped", VecMonitor, indices=[0]) == [[False, False, False]]
    assert vec.env_is_wrapped(VecMonitor) == [False] * 3
    with pytest.raises(AttributeError):
        vec.get_attr("no_such_thing")
    vec.close()


def test_the_bound_can_change_while_the_environments_run() -> None:
    vec = make_env("parkour", 3, seed=SEED, rho=None, min_step_reward=None)
    vec.reset()
    _, _, done, infos = vec.step(actions(1, 3)[0])
    assert not done.any()
    nearest = min(info["deviation"] for info in infos)
    vec.set_attr("rho", nearest / 2)
    assert vec.get_attr("rho") == [nearest / 2] * 3
    assert vec.get_attr("rho", indices=1) == [nearest / 2]
    _, _, done, infos = vec.step(actions(2, 3)[1])
    assert [info["termination"] == "bound" for info in infos] == [info["deviation"] > nearest / 2 for info in infos]
    assert done.any()
    vec.set_attr("rho", None, indices=range(3))
    assert vec.get_attr("rho") == [None] * 3


def test_levels_of_the_curriculum_can_change_each() -> None:
    vec = make_env("parkour", 3, seed=SEED)
    vec.reset()
    assert vec.get_attr("level") == [0.0, 0.0, 0.0]
    vec.set_attr("level", 0.5, indices=[0, 2])
    vec.set_attr("level", 1, indices=1)
    assert vec.get_attr("level") == [0.5, 1.0, 0.5]
    assert vec.get_attr("level", indices=2) == [0.5]
    vec.reset()
    assert vec.get_attr("level") == [0.5, 1.0, 0.5]
    other = make_env("parkour", 3, seed=SEED)
    other.reset(), other.reset()
    assert vec.batch.modes != other.batch.modes


@pytest.mark.parametrize(
    ("name", "value", "indices", "error", "message"),
    [
        ("nonsense", 1, None, AttributeError, r"no 'nonsense' to set \(allowed: level, render_mode, rho\)\.$"),
        ("rh", 1, None, AttributeError, "Did you mean 'rho'"),
        ("rho", 0.3, [0, 1], ValueError, "'rho' is one for all 3 environments, found 'indices' of 2"),
        ("rho", -1.0, None, ValueError, "'rho' must be above 0"),
        ("rho", "tight", None, TypeError, "'rho' must be a number, found the text 'tight'"),
        ("level", 1.5, None, ValueError, "'level' must be at most 1, found 1.5"),
        ("level", None, 0, TypeError, "'level' must be a number, found nothing"),
        ("render_mode", "human", None, ValueError, "unknown render mode 'human'"),
    ],
)
def test_what_cannot_be_set_is_a_sentence(
    name: str, value: Any, indices: Any, error: type[Exception], message: str
) -> None:
    vec = make_env("parkour", 3)
    with pytest.raises(error, match=message):
        vec.set_attr(name, value, indices)
    assert vec.get_attr("rho") == [load_task("parkour").rho] * 3
    assert vec.get_attr("level") == [0.0] * 3


def test_a_level_without_a_curriculum_is_a_sentence() -> None:
    with pytest.raises(ValueError, match="'level' changes nothing: the task has no curriculum"):
        make_env("parkour", curriculum=None).set_attr("level", 0.5)


# ---- copies ----


COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("name", TASKS)
def test_a_copy_of_many_environments_goes_on_bit_for_bit(name: str, way: str) -> None:
    vec = OgmpVecEnv(load_task(name, overrides(name)), 3, SEED, threads=1)
    vec.reset()
    for command in actions(20, 3):
        vec.step(command)
    again = COPIES[way](vec)
    for command in actions(40, 3, 0.4):
        for expected, found in zip(vec.step(command)[:3], again.step(command)[:3], strict=True):
            np.testing.assert_array_equal(found, expected)
    assert again.batch.modes == vec.batch.modes
    again.seed(1), again.reset()  # and from then on alone
    assert again.batch.modes != vec.batch.modes


@pytest.mark.parametrize("way", COPIES)
def test_a_copy_keeps_a_seed_that_waits_and_what_was_set(way: str) -> None:
    vec = make_env("parkour", 2, SEED)
    vec.reset()
    vec.set_attr("rho", 0.123)
    vec.seed(SEED + 50)
    again = COPIES[way](vec)
    assert again.get_attr("rho") == [0.123] * 2
    np.testing.assert_array_equal(again.reset(), vec.reset())
    assert again.batch.modes == vec.batch.modes


@pytest.mark.parametrize("way", COPIES)
def test_a_copy_of_a_batch_goes_on_bit_for_bit(way: str) -> None:
    batch = BatchEnv(load_task("parkour", overrides("parkour")), 2, SEED, threads=1)
    batch.reset()
    batch.step(actions(1, 2)[0])
    again = COPIES[way](batch)
    for command in actions(12, 2):
        expected, found = batch.step(command), again.step(command)
        np.testing.assert_array_equal(found.observation, expected.observation)
        np.testing.assert_array_equal(found.reward, expected.reward)
    assert again.sim.threads == 1


# ---- make_env ----


def test_make_env_takes_a_name_a_file_or_a_task_and_overrides() -> None:
    file = TASKS_DIR / "parkour.yaml"
    for task in ("parkour", str(file), file):
        vec = ogmp_sb3.make_env(task, num_envs=2, rho=0.07, oracle="lqr", **{"modes.jump.h": 0.1})
        assert isinstance(vec, ogmp_sb3.OgmpVecEnv)
        assert vec.num_envs == 2
        assert (vec.batch.task.rho, vec.batch.task.oracle) == (0.07, "lqr")
        assert vec.batch.task.mode_ranges["jump"]["h"].high == 0.1
    task = load_task("dive", {"rho": 0.2})
    assert make_env(task).batch.task is task


@pytest.mark.parametrize("door", [make_env, OgmpEnv])
def test_overrides_of_a_loaded_task_are_applied_or_refused_but_never_ignored(door: Any) -> None:
    try:
        env = door(load_task("parkour"), rho=0.07)
    except (TypeError, ValueError):
        return
    assert env.batch.task.rho == 0.07


@pytest.mark.parametrize("door", [make_env, OgmpEnv])
def test_a_mistake_in_an_override_names_the_file_and_the_closest_key(door: Any) -> None:
    with pytest.raises(KeyError, match=r"parkour\.yaml: 'horizn' is not a known key .*Did you mean 'horizon'\?"):
        door("parkour", horizn=10)
    with pytest.raises(ValueError, match=r"parkour\.yaml: 'rho' must be above 0"):
        door("parkour", rho=-1.0)
    with pytest.raises(KeyError, match="Did you mean 'parkour'"):
        door("parcour")


def test_environment_i_has_the_seed_plus_i() -> None:
    vec = make_env("dive", num_envs=3, seed=SEED)
    vec.reset()
    for row in range(3):
        one = make_env("dive", num_envs=1, seed=SEED + row)
        one.reset()
        assert one.batch.modes[0] == vec.batch.modes[row]


def test_going_on_from_a_saved_state_is_exact() -> None:
    task = load_task("parkour", overrides("parkour"))
    vec, other = OgmpVecEnv(task, 3, SEED, threads=1), OgmpVecEnv(task, 3, SEED + 9, threads=1)
    vec.reset(), other.reset()
    for step, command in enumerate(actions(60, 3)):
        if step == 25:
            other.set_state(*vec.state())
        observation, reward, done, infos = vec.step(command)
        if step >= 25:
            again = other.step(command)
            np.testing.assert_array_equal(again[0], observation)
            np.testing.assert_array_equal(again[1], reward)
            np.testing.assert_array_equal(again[2], done)
            for info, expected in zip(again[3], infos, strict=True):
                for episode in (info.get("episode", {}), expected.get("episode", {})):
                    episode.pop("t", None)
                assert info.get("episode") == expected.get("episode")
