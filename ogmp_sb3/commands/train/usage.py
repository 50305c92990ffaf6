"""The text of ``ogmp-train --help``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.train.command_line import PAPER
from ogmp_sb3.commands.train.trials import SearchConfig
from ogmp_sb3.config import catalogue
from ogmp_sb3.config.editor_schema import field_texts
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.sb3.hyperparameters import DEFAULTS, PPOConfig

SHARED = "sweep"  # what the ready experiments have in common, which is none itself
EXAMPLES = """\
ogmp-train: train one policy for a task, guided by its oracle.

Examples:
  ogmp-train task=parkour rho=0.5
  ogmp-train task=parkour rho=0.5 oracle=lqr horizon=15 seed=1 total_timesteps=1000000
  ogmp-train task=path/to/my_task.yaml
  ogmp-train task=my_task --config-dir path/to/dir          (reads path/to/dir/task/my_task.yaml)
  ogmp-train task=parkour modes.jump.h=[0.1,0.2] curriculum=null
  ogmp-train task=parkour logger=[tensorboard,wandb]         (also mlflow, trackio)
  ogmp-train -m task=parkour rho=0.1,0.3,0.5 oracle=linear,lqr,preview
  ogmp-train -m +experiment=rho task=parkour
  ogmp-train -m +search=rho task=parkour
  ogmp-train -m hydra/sweeper=optuna task=parkour 'rho=interval(0.2,0.8)' oracle=lqr,preview
  ogmp-train resume=runs/parkour/2026-01-31_12-00-00        (goes on where that run stopped)
  ogmp-train resume=latest total_timesteps=30000000
"""
OUTPUT = "A run directory holds config.yaml, progress.csv, TensorBoard events, checkpoints/ and best/."


def usage() -> str:
    """Purpose, examples, options, and every key with its meaning and default."""
    parts = [EXAMPLES, "Options:", *_table(_options()), "", "Keys:", *_table(_keys())]
    return "\n".join(
        [*parts, "  any key of the task file, bare or with 'task.': ogmp-check <task> lists them", "", OUTPUT]
    )


def _options() -> list[tuple[str, str]]:
    experiments = sorted(path.stem for path in (DEFAULTS.parent / "experiment").glob("*.yaml") if path.stem != SHARED)
    of_paper = sorted(path.stem for path in PAPER.glob("*.yaml"))
    return [
        ("-m", "train every combination of the values that have commas between them"),
        ("+experiment=<name>", f"with -m, a ready sweep: {', '.join(experiments)}"),
        ("+experiment=paper/<task>", f"the settings of the paper: {', '.join(of_paper)}"),
        ("+search=<key>", "successive halving over the values of a key: the better half trains on, twice as long"),
        ("hydra/sweeper=optuna", "with -m, a search over intervals and choices of any keys; poor trials stop early"),
        ("--config-dir <dir>", "where else task=<name> is looked for: <dir>/task/<name>.yaml"),
        ("--cfg job", "print the settings instead of training"),
        ("--hydra-help", "the options of Hydra, which reads this command line"),
    ]


def _keys() -> list[tuple[str, str]]:
    defaults = read_yaml(DEFAULTS)
    return [
        ("task", f"{', '.join(catalogue.names('task'))}, or the path of a YAML file (required)"),
        *_fields(TrainConfig, defaults, ""),
        *_fields(PPOConfig, defaults["ppo"], "ppo."),
        (
            "resume",
            "run to go on with: its directory, latest, or part of its name; samples, checkpoints, threads, device, "
            "logger and videos may change",
        ),
        ("hydra.run.dir", "the run directory (default runs/<task>/<time>)"),
        ("hydra.sweep.dir", "directory for the runs of -m (default runs/sweeps/<time>)"),
        *((f"hydra.sweeper.{name}", text) for name, text in _settings()),
        ("hydra/launcher", "where the runs of -m train: basic, joblib, submitit_slurm, ray (default basic)"),
    ]


def _settings() -> list[tuple[str, str]]:
    """Settings of the search by Optuna."""
    defaults = asdict(SearchConfig())
    return [
        (name, f"of hydra/sweeper=optuna: {text} (default {cli.shown(defaults[name])})")
        for name, text in field_texts(SearchConfig).items()
    ]


def _fields(kind: type[Any], defaults: dict[str, Any], prefix: str) -> list[tuple[str, str]]:
    """Key, meaning and default of the fields of a dataclass."""
    return [
        (f"{prefix}{name}", f"{text.replace('``', '')} (default {cli.shown(defaults[name])})")
        for name, text in field_texts(kind).items()
        if not isinstance(defaults[name], dict)
    ]


def _table(rows: list[tuple[str, str]]) -> list[str]:
    width = max(len(key) for key, _ in rows)
    return [f"  {key:<{width}} {text}" for key, text in rows]
