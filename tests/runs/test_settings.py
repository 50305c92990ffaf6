"""What a training needs beside its task."""

from __future__ import annotations

import os
from dataclasses import fields
from importlib import metadata
from typing import Any

import pytest

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.runs.settings import TrainConfig, thread_count, torch_device, versions
from ogmp_sb3.sb3.hyperparameters import DEFAULTS


def settings(**changes: Any) -> dict[str, Any]:
    data = read_yaml(DEFAULTS)
    return {**{field.name: data[field.name] for field in fields(TrainConfig)}, **changes}


def test_the_defaults_are_right_and_complete() -> None:
    assert read(TrainConfig, settings(), Where("train.yaml")).total_timesteps == 20_000_000


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_envs": 0}, "'num_envs' must be at least 1, found 0"),
        ({"seed": -1}, "'seed' must be at least 0, found -1"),
        ({"seed": 2**32}, "'seed' must be at most 4,294,967,295"),
        ({"policy_average": 0}, "'policy_average' must be at least 1 or null, found 0"),
        ({"torch_threads": "all"}, "'torch_threads' must be auto or a whole number from 1 to 1024, found 'all'"),
        ({"device": "gpu"}, "'device' must be cpu, cuda, cuda:<number> or auto, found 'gpu'"),
        (
            {"logger": "wanb"},
            "'logger' is 'wanb' .allowed: mlflow, null, .*, wandb.. Did you mean 'wandb'",
        ),
        ({"logger": ["mlflow", "tensorbord"]}, "'logger' is 'tensorbord' .* Did you mean 'tensorboard'"),
        ({"logger": ["wandb", "wandb"]}, "'logger' names wandb twice"),
        ({"physics_threads": 0}, "'physics_threads' must be auto or a whole number from 1 to 1024, found 0"),
    ],
)
def test_a_value_out_of_range_is_a_sentence(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read(TrainConfig, settings(**changes), Where("train.yaml"))


@pytest.mark.parametrize(
    ("setting", "names"),
    [("tensorboard", ("tensorboard",)), (["wandb", "mlflow"], ("wandb", "mlflow")), (None, ()), ([], ())],
)
def test_the_log_goes_to_one_tracker_or_several_or_none(setting: Any, names: tuple[str, ...]) -> None:
    config = read(TrainConfig, settings(logger=setting), Where("train.yaml"))
    assert config.trackers == names
    assert config.as_data()["logger"] == setting


@pytest.mark.parametrize("setting", [5, True, {"wandb": True}, ["wandb", None], [["wandb"]]])
def test_what_names_no_tracker_is_a_sentence(setting: Any) -> None:
    with pytest.raises(TypeError, match=r"^train.yaml: 'logger(\.\d)?' must be text"):
        read(TrainConfig, settings(logger=setting), Where("train.yaml"))


def test_auto_is_a_thread_for_each_cpu_of_this_process() -> None:
    assert thread_count("auto") == len(os.sched_getaffinity(0))
    assert thread_count(3) == 3


@pytest.mark.parametrize("there, setting, device", [(0, "auto", "cpu"), (1, "auto", "cuda"), (2, "cuda:1", "cuda:1")])
def test_a_device_is_one_that_there_is(there: int, setting: str, device: str, monkeypatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: there > 0)
    monkeypatch.setattr("torch.cuda.device_count", lambda: there)
    assert torch_device("cpu") == "cpu"
    assert torch_device(setting) == device
    with pytest.raises(ValueError, match=f"^'device' is cuda:{there}, but of CUDA devices PyTorch finds "):
        torch_device(f"cuda:{there}")


def test_versions_are_those_installed() -> None:
    recorded = versions()
    assert recorded["mujoco"] == metadata.version("mujoco")
    assert {"python", "machine", "torch", "sb3-contrib"} <= set(recorded)
