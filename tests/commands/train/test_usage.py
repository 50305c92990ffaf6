"""What ogmp-train says of itself."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from helpers.programs import program
from ogmp_sb3.commands import cli
from ogmp_sb3.commands.train.usage import usage
from ogmp_sb3.config.editor_schema import field_texts
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.sb3.hyperparameters import DEFAULTS, PPOConfig


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"], ["-m", "--help", "task=nowhere"]])
def test_help_needs_no_task_and_is_there_without_arguments(arguments: list[str], tmp_path: Path) -> None:
    done = program("train", *arguments, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{usage()}\n", "")
    assert not list(tmp_path.iterdir())
    assert "  ogmp-train task=parkour rho=0.5\n" in done.stdout


def test_every_key_is_there_with_its_meaning_and_default() -> None:
    lines = [" ".join(line.split()) for line in usage().splitlines()]
    defaults = read_yaml(DEFAULTS)
    for kind, prefix, values in ((TrainConfig, "", defaults), (PPOConfig, "ppo.", defaults["ppo"])):
        for field in dataclasses.fields(kind):
            if field.name != "ppo":
                (line,) = (line for line in lines if line.startswith(f"{prefix}{field.name} "))
                assert field_texts(kind)[field.name].replace("``", "") in line
                assert line.endswith(f" (default {cli.shown(values[field.name])})")


def test_tasks_and_ready_experiments_are_there_and_nothing_of_the_yaml() -> None:
    text = usage()
    assert "task dive, dive_robot, parkour, parkour_robot, stairs, or the path of a YAML file (required)" in " ".join(
        text.split()
    )
    assert "a ready sweep: horizon, observations, oracle_rho, rho, unguided\n" in text
    assert "???" not in text and "defaults:" not in text and "${" not in text
