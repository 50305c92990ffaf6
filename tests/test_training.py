"""Runs that go on: directories used again, multiruns, ready sweeps."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from programs import SMALL, program

from ogmp_sb3.checkpoints import checkpoint_dirs
from ogmp_sb3.config import PACKAGE

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
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.safetensors")} == before


def test_a_multirun_has_a_directory_by_default(tmp_path: Path) -> None:
    done = program("train", "-m", "task=dive", "seed=0,1", "total_timesteps=128", *SMALL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("runs/sweeps/*/*seed=[01]*/config.yaml"))) == 2


@pytest.mark.parametrize("name", [path.stem for path in (CONF / "experiment").glob("*.yaml") if path.stem != "sweep"])
def test_every_ready_sweep_composes(name: str, tmp_path: Path) -> None:
    arguments = ["-m", f"+experiment={name}", "task=parkour", "total_timesteps=16", "num_envs=1", "ppo.n_steps=16"]
    small = ["ppo.batch_size=16", "ppo.n_epochs=1", "ppo.lstm_hidden_size=8", "hydra/launcher=basic"]
    done = program("train", *arguments, *small, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    configs = [yaml.safe_load(p.read_text())["task"] for p in tmp_path.glob(f"runs/experiments/{name}/*/config.yaml")]
    assert len({json.dumps(config, sort_keys=True) for config in configs}) == len(configs) > 1


def test_a_killed_sweep_is_finished_by_the_same_command(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ogmp_sb3.train", "-m", "task=dive", "seed=0,1,2,3", *SMALL]
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
