"""At home in the Stable-Baselines3 world: its wrappers, its callbacks, its algorithms and its Zoo, used as they are."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import sb3_contrib
import torch
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize, VecVideoRecorder
from stable_baselines3.common.vec_env.base_vec_env import tile_images

import ogmp_sb3
from helpers.paths import ROOT
from ogmp_sb3 import OgmpEnv, RecurrentPPO, zoo
from ogmp_sb3.sb3.hyperparameters import default_ppo

DOCS = ROOT / "docs"
PARKOUR = "ogmp_sb3:OGMP/Parkour-v0"
SMALL: dict[str, Any] = {"n_steps": 32, "batch_size": 64, "n_epochs": 1, "seed": 0, "device": "cpu"}
NETWORK = {"net_arch": [], "lstm_hidden_size": 16, "n_lstm_layers": 2}


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)  # beside other load, two threads spin against each other


def ours(num_envs: int, seed: int) -> VecEnv:
    return VecMonitor(ogmp_sb3.make_env("parkour", num_envs, seed, rho=0.1))


def theirs(num_envs: int, seed: int) -> VecEnv:
    return make_vec_env(PARKOUR, num_envs, seed, env_kwargs={"rho": 0.1})


@pytest.mark.parametrize("make", [ours, theirs])
def test_stock_ppo_learns_with_stock_wrappers_and_callbacks(make: Callable[[int, int], VecEnv], tmp_path: Path) -> None:
    env = VecNormalize(make(4, 0))
    eval_env = VecNormalize(make(2, 100), training=False, norm_reward=False)
    evaluation = EvalCallback(
        eval_env, n_eval_episodes=3, eval_freq=32, log_path=tmp_path, best_model_save_path=tmp_path, verbose=0
    )
    checkpoints = CheckpointCallback(save_freq=32, save_path=tmp_path, save_vecnormalize=True)
    model = PPO("MlpPolicy", env, **SMALL)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.learn(256, callback=[evaluation, checkpoints])

    assert model.num_timesteps == 256
    for episode in model.ep_info_buffer:
        assert 1 <= episode["l"] <= 300
        assert np.isfinite(episode["r"])
    logged = np.load(tmp_path / "evaluations.npz")
    assert logged["results"].shape == logged["ep_lengths"].shape == (2, 3)
    assert np.isfinite(logged["results"]).all()
    assert (logged["ep_lengths"] >= 1).all()

    normaliser = VecNormalize.load(str(tmp_path / "rl_model_vecnormalize_256_steps.pkl"), make(1, 0))
    np.testing.assert_array_equal(normaliser.obs_rms.mean, env.obs_rms.mean)
    observation = env.reset()
    for file in ("rl_model_256_steps.zip", "best_model.zip"):
        action, _ = PPO.load(tmp_path / file).predict(observation, deterministic=True)
        assert action.shape == (4, 10)


def test_stock_ppo_learns_on_the_gymnasium_environment() -> None:
    with gymnasium.make(PARKOUR, rho=0.1) as env:
        model = PPO("MlpPolicy", env, **{**SMALL, "batch_size": 32}).learn(256)
    assert model.num_timesteps == 256
    assert len(model.ep_info_buffer) > 0


def test_an_evaluation_by_sb3_has_the_returns_of_the_episodes() -> None:
    env = ours(2, 0)
    model = PPO("MlpPolicy", env, **SMALL)
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=4, return_episode_rewards=True)
    mean, _ = evaluate_policy(model, ogmp_sb3.make_env("parkour", 2, rho=0.1), n_eval_episodes=4, warn=False)
    assert len(returns) == len(lengths) == 4
    assert mean == pytest.approx(np.mean(returns), rel=1e-5)


def test_every_name_that_the_package_exports_is_there_and_documented() -> None:
    page = (DOCS / "api.rst").read_text(encoding="utf-8").partition("The modules are")[0]
    assert re.findall(r"^- :\w+:`~[\w.]+\.(\w+)`", page, re.MULTILINE) == sorted(
        ogmp_sb3.__all__, key=lambda name: page.index(f".{name}`")
    )
    for name, module in re.findall(r"^- :\w+:`~([\w.]+)\.(\w+)`", page, re.MULTILINE):
        assert getattr(importlib.import_module(name), module) is getattr(ogmp_sb3, module)


@pytest.mark.parametrize("page", [DOCS / "sb3.md", DOCS.parent / "README.md"], ids=lambda page: page.name)
def test_the_examples_in_python_run(page: Path, opengl, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tasks").symlink_to(DOCS.parent / "tasks")
    smaller = {"100_000": "128", "eval_freq=1000": "eval_freq=1_000_000", "num_envs=64": "num_envs=2", ", 20,": ", 1,"}
    names: dict[str, Any] = {}
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        if "rl_zoo3" not in block and "VecVideoRecorder" not in block:
            for whole, part in smaller.items():
                block = block.replace(whole, part)
            exec(compile(block, page.name, "exec"), names)
    assert (tmp_path / "my_policy.zip").is_file()
    assert len(names["episodes"]) == 1


def test_our_recurrent_ppo_is_saved_loaded_and_trained_on(tmp_path: Path) -> None:
    env = VecNormalize(ours(4, 0), norm_reward=False)
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **SMALL).learn(256)
    model.save(tmp_path / "model.zip")
    again = RecurrentPPO.load(tmp_path / "model.zip", env=env)
    stock = sb3_contrib.RecurrentPPO.load(tmp_path / "model.zip")
    state, observation = None, env.reset()
    for starts in ([True] * 4, [False] * 4, [False, True, False, False]):
        expected, following = model.predict(observation, state, np.array(starts), deterministic=True)
        for other in (again, stock):
            action, _ = other.predict(observation, state, np.array(starts), deterministic=True)
            np.testing.assert_allclose(action, expected, atol=1e-6)
        state, (observation, *_) = following, env.step(expected)
    again.learn(128, reset_num_timesteps=False)
    assert again.num_timesteps == 256 + 128


def moves(step: Callable[[np.ndarray], Any], steps: int, shape: tuple[int, ...]) -> None:
    for _ in range(steps):
        step(np.zeros(shape, np.float32))


def differs(first: np.ndarray, second: np.ndarray) -> float:
    """Share of the pixels that are clearly different."""
    return float((np.abs(first.astype(int) - second).max(axis=-1) > 40).mean())


def test_a_gymnasium_environment_gives_pictures_of_what_it_does(opengl) -> None:
    with gymnasium.make(PARKOUR, render_mode="rgb_array", rho=None) as env:
        assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 33}
        env.reset(seed=0)
        first, again = env.render(), env.render()
        moves(env.step, 8, (10,))
        later = env.render()
        env.reset(seed=0)
        anew = env.render()
    assert (first.dtype, first.shape) == (np.uint8, (320, 480, 3))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, anew)
    assert 0.003 < differs(first, later) < 0.6


def test_our_vecenv_gives_a_picture_of_each_environment_and_sb3_tiles_them(opengl) -> None:
    env = VecMonitor(ogmp_sb3.make_env("parkour", 3, render_mode="rgb_array", curriculum=None))
    env.reset()
    images, tiled = env.get_images(), env.render()
    assert [image.shape for image in images] == [(320, 480, 3)] * 3
    np.testing.assert_array_equal(tiled, tile_images(images))
    env.close()


def test_sb3_records_a_video(opengl, tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="VecVideoRecorder needs moviepy")
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="reading the video needs the extra 'viewer'")
    vec = ogmp_sb3.make_env("parkour", 1, render_mode="rgb_array", rho=None)
    env = VecVideoRecorder(VecMonitor(vec), str(tmp_path), lambda step: step == 0, video_length=5)
    env.reset()
    moves(env.step, 6, (1, 10))
    env.close()
    (video,) = tmp_path.glob("*.mp4")
    reader = ffmpeg.read_frames(str(video))
    meta = next(reader)
    assert (meta["size"], meta["fps"]) == ((480, 320), 33.0)
    assert len(list(reader)) == 6


def test_without_a_render_mode_nothing_is_drawn() -> None:
    assert ogmp_sb3.make_env("dive", 2).get_images() == [None, None]
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert OgmpEnv("dive").render() is None


@pytest.mark.parametrize("make", [OgmpEnv, ogmp_sb3.make_env])
def test_an_unknown_render_mode_is_a_sentence(make: Callable[..., Any]) -> None:
    with pytest.raises(ValueError, match=r"unknown render mode 'rgb_aray' .*Did you mean 'rgb_array'"):
        make("parkour", render_mode="rgb_aray")


# ---- the RL Zoo ----


def test_the_zoo_s_hyper_parameters_are_plain_data_and_those_of_ogmp_train() -> None:
    given = dict(zoo.hyperparams["default"])
    assert yaml.safe_load(yaml.safe_dump(given)) == given
    assert {key: given[key] for key in ("n_steps", "batch_size", "gamma", "target_kl")} == {
        key: getattr(default_ppo(), key) for key in ("n_steps", "batch_size", "gamma", "target_kl")
    }
    for key in ("n_envs", "n_timesteps", "normalize"):  # what the Zoo itself takes
        del given[key]
    given["policy"] = RecurrentPPO.policy_aliases["MlpLstmPolicy"]
    assert given["policy"].__name__ == zoo.hyperparams["default"]["policy"].rpartition(".")[2]
    model = sb3_contrib.RecurrentPPO(env=ours(1, 0), device="cpu", **given)
    assert model.policy.log_std.exp().mean().item() == pytest.approx(0.13 / 2.0)


@pytest.mark.skipif(importlib.util.find_spec("rl_zoo3") is None, reason="rl_zoo3 is not installed")
def test_the_zoo_trains_and_plays(tmp_path: Path) -> None:
    task = ["--algo", "ppo_lstm", "--env", "OGMP/Parkour-v0", "--gym-packages", "ogmp_sb3", "--device", "cpu"]
    task += ["--num-threads", "1"]
    train = ["train", *task, "-conf", "ogmp_sb3.zoo", "-n", "256", "--eval-freq", "128", "--eval-episodes", "1"]
    train += ["-params", "n_envs:2", "batch_size:64"]
    for arguments in (train, ["enjoy", *task, "-f", "logs", "--no-render", "-n", "20"]):
        command = [str(Path(sys.executable).parent / "rl_zoo3"), *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=os.environ, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    (folder,) = (tmp_path / "logs" / "ppo_lstm").iterdir()
    assert {"best_model.zip", "evaluations.npz"} <= {path.name for path in folder.iterdir()}
    assert sb3_contrib.RecurrentPPO.load(folder / "OGMP-Parkour-v0.zip").num_timesteps == 256
