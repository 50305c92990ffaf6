"""Run the programs as a user does, with budgets of seconds."""

from __future__ import annotations

import configparser
import csv
import importlib
import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from helpers.paths import ROOT

SMALL = ["num_envs=8", "ppo.n_steps=16", "ppo.batch_size=64", "ppo.n_epochs=2", "torch_threads=1", "physics_threads=1"]


def script(name: str) -> str:
    """The module behind a console script."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg", encoding="utf-8")
    lines = setup["options.entry_points"]["console_scripts"].split("\n")
    targets = dict(line.replace(" ", "").split("=") for line in lines if line)
    return targets[name].partition(":")[0]


@dataclass
class Result:
    returncode: int
    stdout: str
    stderr: str


def program(name: str, *arguments: str, cwd: Path) -> Result:
    """Run a program as the shell would, without the seconds that a new interpreter costs."""
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(cwd)
        patch.setattr("sys.argv", [f"ogmp-{name}", *arguments])
        try:
            importlib.import_module(script(f"ogmp-{name}")).main()
        except SystemExit as stop:
            code = int(stop.code or 0)
    return Result(code, out.getvalue(), err.getvalue())


def progress(run_dir: Path) -> list[int]:
    with (run_dir / "progress.csv").open(newline="") as file:
        return [int(row["time/total_timesteps"]) for row in csv.DictReader(file)]
