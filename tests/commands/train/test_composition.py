"""Keys of the task with ``task.`` and without come to the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers.programs import SMALL, program
from ogmp_sb3.commands.train.command_line import TASK_KEYS
from ogmp_sb3.runs.settings import TrainConfig


def trained(folder: Path, *arguments: str) -> dict[str, Any]:
    done = program("train", "task=dive", "total_timesteps=64", *SMALL, *arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    return {file.parent.name: yaml.safe_load(file.read_text())["task"] for file in folder.rglob("config.yaml")
            if file.parent.name != ".hydra"}  # fmt: skip


@pytest.mark.parametrize("given", [["modes.flip.h=[1.0,1.1]", "rho=null", "feedback=[z]", "+sampling.weights.flip=2"],
                                   ["curriculum={}", "observations={clock:null}", "restarts=null"]])  # fmt: skip
def test_a_key_means_the_same_with_task_and_without(given: list[str], tmp_path: Path) -> None:
    prefixed = [argument.replace("+", "+task.") if "+" in argument else f"task.{argument}" for argument in given]
    trained(tmp_path, *given, "hydra.run.dir=bare")
    found = trained(tmp_path, *prefixed, "hydra.run.dir=prefixed")
    assert found["bare"] == found["prefixed"]


def test_a_sweep_names_its_directories_by_what_was_typed_and_the_same_command_finds_them(tmp_path: Path) -> None:
    arguments = ["-m", "modes.flip.h=1.0,1.1", "hydra.sweep.dir=sweep"]
    first = trained(tmp_path, *arguments)
    assert sorted(task["modes"]["flip"]["h"] for task in first.values()) == [1.0, 1.1]
    assert {name.partition(",num_envs")[0] for name in first} == {"modes.flip.h=1.0", "modes.flip.h=1.1"}
    done = program("train", "task=dive", "total_timesteps=64", *SMALL, *arguments, cwd=tmp_path)
    assert done.stdout.count("already") == 2


def test_no_setting_of_a_training_has_the_name_of_a_key_of_the_task() -> None:
    assert not set(TASK_KEYS) & set(TrainConfig.__dataclass_fields__)
