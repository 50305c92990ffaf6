"""What a training says before its first sample."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from helpers.learners import learner
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.runs.banner import banner, typed_at_first
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.sb3.hyperparameters import DEFAULTS

KEYS = ["task", "changed", "robot", "observation", "network", "samples", "threads", "time", "TensorBoard"]


@pytest.fixture(scope="module")
def config() -> TrainConfig:
    data = {key: value for key, value in read_yaml(DEFAULTS).items() if key not in ("defaults", "hydra")}
    data |= {"num_envs": 2, "total_timesteps": 5000, "torch_threads": 3, "physics_threads": 1}
    data["ppo"] = {**data["ppo"], "n_steps": 8, "lstm_hidden_size": 8, "n_lstm_layers": 1}
    return read(TrainConfig, data, Where("test"))


def rows(text: str) -> dict[str, str]:
    return dict(line.strip().split(None, 1) for line in text.splitlines()[1:])


def test_the_banner_says_where_what_and_with_how_much(config: TrainConfig, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    model, _ = learner(rho=0.25)
    text = banner(tmp_path / "runs" / "a b", config, model, ["task=dive", "rho=0.25", "modes.flip.h=[1, 2]"])
    found = rows(text)
    assert text.splitlines()[0] == "runs/a b"
    assert list(found) == KEYS
    assert "rho 0.25" in found["task"] and found["task"].startswith("dive: ")
    assert found["changed"] == "rho=0.25 'modes.flip.h=[1, 2]'"
    inputs, hidden, joints = model.observation_space.shape[0], 8, 10
    lstm = 4 * hidden * (inputs + hidden) + 2 * 4 * hidden
    count = 2 * lstm + (hidden + 1) * joints + (hidden + 1) + joints  # actor and critic, their outputs, the noise
    assert found["network"] == f"LSTM 1 x 8 each for actor and critic, {count:,} parameters"
    assert found["observation"] == f"{inputs} numbers"
    assert found["samples"] == "5,000, 16 to an update from 2 environments"
    assert found["threads"] == "1 for physics, 3 for the networks, which are on cpu"
    assert found["TensorBoard"] == "tensorboard --logdir 'runs/a b'"
    assert text.isascii() and "\x1b" not in text


def test_a_run_that_goes_on_shows_what_it_was_begun_with(tmp_path: Path) -> None:
    text = "task: {}\ntask_file: a.yaml\ntrain: {}\noverrides: [task=dive, rho=0.2, total_timesteps=512, +videos=9]\n"
    (tmp_path / "config.yaml").write_text(text)
    assert typed_at_first(tmp_path) == ("task=dive", "rho=0.2")
    (tmp_path / "config.yaml").write_text(text.replace("[task", "3 #"))
    with pytest.raises(ValueError, match=r"config.yaml: 'overrides' must be a list"):
        typed_at_first(tmp_path)


def test_the_banner_of_a_run_that_goes_on_says_from_where(config: TrainConfig, tmp_path: Path) -> None:
    model, _ = learner(rho=None, critic_observations={"reference_error": {}})
    model.num_timesteps = 3200
    wider = replace(config, ppo=replace(config.ppo, input_layers=(16,), critic_layers=(64, 32)))
    found = rows(banner(tmp_path, wider, model, []))
    assert found["samples"].startswith("3,200 of 5,000, ")
    assert found["changed"] == "nothing, all settings are the defaults"
    assert "no bound" in found["task"] and "more for the critic" in found["observation"]
    assert found["network"].startswith("layers of 16 and LSTM 1 x 8 for the actor, layers of 64, 32 for the critic, ")
