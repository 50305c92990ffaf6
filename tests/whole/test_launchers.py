"""Sweeps whose jobs run in other processes, by the launchers that clusters use."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from helpers.programs import SMALL
from ogmp_sb3.config.catalogue import ROBOTS_DIR, TASKS_DIR
from ogmp_sb3.runs.run_directory import checkpoint_dirs

LAUNCHERS = {
    "joblib": ("sweep", ["hydra.launcher.n_jobs=2"]),
    "submitit_local": ("submitit", ["hydra.launcher.timeout_min=10"]),
    "ray": ("ray", ["+hydra.launcher.ray.init.num_cpus=2", "+hydra.launcher.ray.init.include_dashboard=false"]),
}
"""The extra that brings each launcher, and its settings."""


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_jobs_in_other_processes_train_a_task_given_by_path_and_the_same_command_leaves_them_alone(
    launcher: str, tmp_path: Path
) -> None:
    extra, settings = LAUNCHERS[launcher]
    if importlib.util.find_spec(f"hydra_plugins.hydra_{launcher.split('_')[0]}_launcher") is None:
        pytest.skip(f"the launcher '{launcher}' needs the extra '{extra}'")
    (tmp_path / "mine").mkdir()
    shutil.copytree(ROBOTS_DIR / "hector", tmp_path / "mine" / "robot")
    task = yaml.safe_load((TASKS_DIR / "stairs.yaml").read_text()) | {"robot": "robot/robot.yaml"}
    (tmp_path / "mine" / "hill.yaml").write_text(yaml.safe_dump(task))
    command = [
        sys.executable,
        "-m",
        "ogmp_sb3.commands.train.program",
        "-m",
        "task=mine/hill.yaml",
        "rho=0.2,null",
        *SMALL,
    ]
    command += ["total_timesteps=128", "hydra.sweep.dir=sweep", f"hydra/launcher={launcher}", *settings]
    environment = {**os.environ, "HOME": str(tmp_path)}  # where Ray keeps its token

    def run() -> dict[object, int]:
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        jobs = {path.parent: yaml.safe_load(path.read_text()) for path in tmp_path.glob("sweep/*/config.yaml")}
        assert all(job["task_file"] == "mine/hill.yaml" for job in jobs.values())
        return {jobs[job]["task"]["rho"]: checkpoint_dirs(job)[-1].stat().st_mtime_ns for job in jobs}

    first = run()
    assert set(first) == {0.2, None}
    assert run() == first
