"""Runs that go on: directories used again, multiruns, ready sweeps."""

from __future__ import annotations

import gc
import json
import shutil
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
import yaml
from safetensors.torch import load_file

from helpers.paths import ROOT
from helpers.programs import SMALL, program
from ogmp_sb3.config.catalogue import PACKAGE, find
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.env.batch_env import BatchEnv, StepResult
from ogmp_sb3.runs.atomic import locked
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import checkpoint_dirs, read_log, read_run, run_config
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.runs.storage import write_manifest
from ogmp_sb3.runs.training import Job, train

CONF = PACKAGE / "conf"


def test_the_same_command_goes_on_with_a_run_and_leaves_a_finished_one_alone(tmp_path: Path) -> None:
    arguments = ["task=dive", "rho=0.2", *SMALL, "hydra.run.dir=run"]
    assert program("train", *arguments, "total_timesteps=128", cwd=tmp_path).returncode == 0
    finished = checkpoint_dirs(tmp_path / "run")[-1]
    written = finished.stat().st_mtime_ns
    again = program("train", *arguments, "total_timesteps=128", cwd=tmp_path)
    assert "trained to step 128 already" in again.stdout
    assert finished.stat().st_mtime_ns == written
    longer = program("train", *arguments, "total_timesteps=256", cwd=tmp_path)
    assert "resumed at step 128" in longer.stdout
    assert int(checkpoint_dirs(tmp_path / "run")[-1].name) == 256


def test_another_run_is_not_written_over(tmp_path: Path) -> None:
    arguments = ["task=dive", "total_timesteps=128", *SMALL, "hydra.run.dir=run"]
    assert program("train", *arguments, "rho=0.2", cwd=tmp_path).returncode == 0
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.safetensors")}
    done = program("train", *arguments, "rho=0.3", cwd=tmp_path)
    assert done.returncode == 2
    assert "holds another run: 'task.rho' is 0.2 there and 0.3 here" in done.stderr
    assert "rho=0.2" in read_run(tmp_path / "run").overrides
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.safetensors")} == before


def test_a_training_leaves_no_environment_in_memory(tmp_path: Path) -> None:
    data = read_yaml(CONF / "train.yaml")
    settings = {key: data[key] for key in (field.name for field in fields(TrainConfig)) if key in data}
    settings |= {"total_timesteps": 16, "num_envs": 1}
    settings["ppo"] |= {"n_steps": 16, "batch_size": 16, "n_epochs": 1}
    task_data = read_yaml(find("task", "dive"))
    before = sum(type(thing) is BatchEnv for thing in gc.get_objects())
    config = read(TrainConfig, settings, Where("settings"))
    task = task_from_data(task_data, find("task", "dive"))
    train(Job(task=task, task_data=task_data, config=config, run_dir=tmp_path / "run"), resume=False)
    assert sum(type(thing) is BatchEnv for thing in gc.get_objects()) <= before


def test_a_multirun_has_a_directory_by_default(tmp_path: Path) -> None:
    done = program("train", "-m", "task=dive", "seed=0,1", "total_timesteps=128", *SMALL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("runs/sweeps/*/*seed=[01]*/config.yaml"))) == 2


@pytest.mark.parametrize("name", [path.stem for path in (CONF / "experiment").glob("*.yaml") if path.stem != "sweep"])
def test_every_ready_sweep_composes(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs: list[Job] = []

    def begin(job: Job) -> float:
        """A training costs more than what is tested, and so do environments that differ in rho alone."""
        known = {json.dumps({**other.task_data, "rho": None}, sort_keys=True) for other in jobs}
        if json.dumps({**job.task_data, "rho": None}, sort_keys=True) not in known:
            BatchEnv(job.task)
        jobs.append(job)
        return 0.0

    monkeypatch.setattr("ogmp_sb3.commands.train.program.begin_or_go_on", begin)
    done = program("train", "-m", f"+experiment={name}", "task=parkour", "hydra/launcher=basic", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {job.run_dir.parent for job in jobs} == {tmp_path / "runs" / "experiments" / name / "parkour"}
    assert len({json.dumps(job.task_data, sort_keys=True) for job in jobs}) == len(jobs) > 1
    assert len({job.run_dir for job in jobs}) == len(jobs)


def test_a_killed_sweep_is_finished_by_the_same_command(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ogmp_sb3.commands.train.program", "-m", "task=dive", "seed=0,1,2,3", *SMALL]
    command += ["total_timesteps=1024", "checkpoint_interval=128", "hydra.sweep.dir=sweep"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 120
        while len(list(tmp_path.glob("sweep/*/checkpoints/*[0-9]"))) < 4 and time.monotonic() < deadline:
            time.sleep(0.02)
        process.kill()
    before = {folder.parent.parent: folder.stat().st_mtime_ns for folder in tmp_path.glob("sweep/*/checkpoints/*1024")}
    assert len(before) < 4
    done = program("train", *command[3:], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    after = {folder.parent.parent: folder.stat().st_mtime_ns for folder in tmp_path.glob("sweep/*/checkpoints/*1024")}
    assert len(after) == 4
    assert all(after[folder] == written for folder, written in before.items())
    assert done.stdout.count("already") == len(before)


def test_a_killed_run_goes_on_and_ends_as_if_it_had_not_been(tmp_path: Path) -> None:
    """benchmarks/kill_training.py, which is to be run with more kills now and then."""
    script = ROOT / "benchmarks" / "kill_training.py"
    command = [sys.executable, script, "kills=2", "samples=1024", "seed=1", f"out={tmp_path / 'kills'}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 kills: at most" in done.stdout
    assert "all went on" in done.stdout


def test_a_run_without_a_checkpoint_yet_is_begun_anew_by_resume(tmp_path: Path) -> None:
    arguments = ["task=dive", *SMALL, "total_timesteps=128", "hydra.run.dir=run"]
    assert program("train", *arguments, cwd=tmp_path).returncode == 0
    shutil.rmtree(tmp_path / "run" / "checkpoints")
    done = program("train", "resume=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "no checkpoint yet: beginning anew" in done.stdout
    assert [int(folder.name) for folder in checkpoint_dirs(tmp_path / "run")] == [128]


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        ({}, "'task' is missing"),
        ({"task": 3}, "'task' must be a mapping"),
        ({"task": {}, "task_file": 1}, "'task_file'"),
    ],
)
def test_a_configuration_that_is_none_is_a_sentence(data, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ValueError, match=f"config.yaml: {sentence}"):
        run_config(tmp_path)


def test_two_trainings_in_one_directory_are_refused(tmp_path: Path) -> None:
    arguments = ["task=dive", *SMALL, "total_timesteps=128", "hydra.run.dir=run"]
    (tmp_path / "run").mkdir()
    with locked(tmp_path / "run"):
        done = program("train", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "run: another process is training there." in done.stderr


def test_a_training_with_rewards_that_are_none_stops_with_a_sentence_and_keeps_its_weights(
    tmp_path: Path, monkeypatch
) -> None:
    arguments = ["task=dive", *SMALL, "total_timesteps=6400", "checkpoint_interval=128", "hydra.run.dir=run"]
    arguments += ["policy_average=null"]
    step, rows = BatchEnv.step, iter(range(10**6))

    def spoilt(self: BatchEnv, *given: Any) -> StepResult:
        result = step(self, *given)
        return replace(
            result, reward=result.reward * (np.nan if next(rows) >= 16 else 1.0)
        )  # from the second rollout on

    monkeypatch.setattr(BatchEnv, "step", spoilt)
    with pytest.warns(UserWarning, match="undone: a reward of the rollout is not finite") as caught:
        done = program("train", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "stopped at step 1408: 10 updates in a row were undone, the last because a reward" in done.stderr
    assert len([w for w in caught if "undone" in str(w.message)]) == 9
    first, *_, last = (load_file(folder / "policy.safetensors") for folder in checkpoint_dirs(tmp_path / "run"))
    assert all(th.equal(first[name], last[name]) for name in first)

    monkeypatch.setattr(BatchEnv, "step", step)
    again = program("train", "resume=run", "total_timesteps=1536", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert "resumed at step 1280" in again.stdout
    assert read_log(tmp_path / "run" / "progress.csv")["train/undone_updates"][-1] == 9


def test_a_run_without_a_checkpoint_is_not_written_over_by_another(tmp_path: Path) -> None:
    arguments = ["task=dive", *SMALL, "total_timesteps=256", "hydra.run.dir=run"]
    assert program("train", *arguments, cwd=tmp_path).returncode == 0
    shutil.rmtree(tmp_path / "run" / "checkpoints")
    log = (tmp_path / "run" / "progress.csv").read_bytes()
    done = program("train", *arguments, "rho=0.123", cwd=tmp_path)
    assert done.returncode == 2
    assert "holds another run: 'task.rho' is 0.3 there and 0.123 here" in done.stderr
    assert (tmp_path / "run" / "progress.csv").read_bytes() == log
    assert program("train", *arguments, cwd=tmp_path).returncode == 0


def test_checkpoints_without_a_configuration_are_not_trained_over(tmp_path: Path) -> None:
    arguments = ["task=dive", *SMALL, "total_timesteps=256", "hydra.run.dir=run"]
    assert program("train", *arguments, cwd=tmp_path).returncode == 0
    (tmp_path / "run" / "config.yaml").unlink()
    done = program("train", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "run: has checkpoints, but no config.yaml. Choose another directory" in done.stderr
    assert len(checkpoint_dirs(tmp_path / "run")) > 0


def test_a_finished_run_that_was_killed_before_its_best_policy_was_copied_gets_it(tmp_path: Path) -> None:
    arguments = ["task=dive", *SMALL, "total_timesteps=256", "checkpoint_interval=128", "hydra.run.dir=run"]
    assert program("train", *arguments, cwd=tmp_path).returncode == 0
    last = checkpoint_dirs(tmp_path / "run")[-1]
    trainer = json.loads((last / "trainer.json").read_text())
    trainer["statistics"]["best_at"] = int(last.name)
    (last / "trainer.json").write_text(json.dumps(trainer))
    (last / "manifest.json").unlink()
    write_manifest(last)
    shutil.rmtree(tmp_path / "run" / "best")
    assert "already" in program("train", *arguments, cwd=tmp_path).stdout
    assert load_policy(tmp_path / "run" / "best").info["num_timesteps"] == int(last.name)
