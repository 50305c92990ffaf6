"""``ogmp-train``: train one policy for a task, or a sweep of them (``-m``), or go on with a run (``resume=``)."""

from __future__ import annotations

import math
import sys
from dataclasses import asdict
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.named_run import named_run
from ogmp_sb3.commands.train.command_line import PROGRAM, checked, joined, run_hydra, sentence
from ogmp_sb3.commands.train.composition import register_composition
from ogmp_sb3.commands.train.failures import tell_failures
from ogmp_sb3.commands.train.jobs import check_films, read_job, warn_of_encoder
from ogmp_sb3.commands.train.optuna_search import OptunaSweeper, with_folder
from ogmp_sb3.commands.train.search import HALVING, HalvingSweeper, check_one_task, expanded
from ogmp_sb3.commands.train.start import remove_unused
from ogmp_sb3.commands.train.sweeper import register_sweepers
from ogmp_sb3.commands.train.tasks import register_tasks, registered_data
from ogmp_sb3.commands.train.trials import SearchConfig
from ogmp_sb3.commands.train.usage import usage
from ogmp_sb3.config.catalogue import find
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_value, resolved
from ogmp_sb3.runs.logs import LOG, say, transcript
from ogmp_sb3.runs.own_files import run_robot
from ogmp_sb3.runs.robot_copy import ROBOT
from ogmp_sb3.runs.run_directory import CONFIG, FAILURE, RESUMABLE, checkpoint_dirs, run_config
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.runs.training import Job, begin_or_go_on, train


@hydra.main(version_base="1.3", config_path="pkg://ogmp_sb3.conf", config_name="train")
def _hydra_main(cfg: DictConfig) -> float | None:
    run_dir = Path(HydraConfig.get().runtime.output_dir)
    with transcript(run_dir):
        try:
            job = read_job(cfg, run_dir)
            warn_of_encoder(job)
            mean = begin_or_go_on(job)
            return mean if math.isfinite(mean) else None
        except OmegaConfBaseException as error:  # of Hydra's own part
            _fail(run_dir, ValueError(sentence(error)))
        except cli.MISTAKES as error:
            _fail(run_dir, error)
    return None  # no value: to sweepers that search, the job failed, while nan would end their search


def _fail(run_dir: Path, error: Exception) -> None:
    """End a run with a sentence; in a multirun leave it to the end, for the other jobs go on."""
    text = cli.one_line(PROGRAM, error)
    LOG.error(text)
    if HydraConfig.get().mode != RunMode.MULTIRUN:
        cli.fail(PROGRAM, error)
    (run_dir / FAILURE).write_text(text, encoding="utf-8")


def _resume(arguments: list[str]) -> None:
    """``ogmp-train resume=<run dir> [total_timesteps=...]``: everything else is as it was."""
    changes = dict(argument.partition("=")[::2] for argument in arguments)
    run_dir = Path(named_run(PROGRAM, changes.pop("resume"), to_resume=True))
    data = run_config(run_dir)
    if "robot" in changes and (run_dir / ROBOT).is_dir():
        raise KeyError(f"'robot' cannot change when a run is resumed: it goes on with {run_dir / ROBOT}.")
    if "robot" in changes:
        data["task"]["robot"] = str(find("robot", changes.pop("robot")).absolute())
    for key, value in changes.items():
        if key not in RESUMABLE:
            raise KeyError(f"'{key}' cannot change when a run is resumed{did_you_mean(key, RESUMABLE)}")
        data["train"][key] = read_value(value)
    where = Where(str(run_dir / CONFIG), "train")
    data["train"] = resolved(data["train"], where)
    task = task_from_data({**data["task"], "robot": str(run_robot(run_dir, data))}, Path(data["task_file"]))
    config = read(TrainConfig, data["train"], where)
    check_films(config)
    resume = bool(checkpoint_dirs(run_dir))
    with transcript(run_dir):
        if not resume:
            say("there is no checkpoint yet: beginning anew")
        try:
            train(Job(task=task, task_data=data["task"], config=config, run_dir=run_dir), resume)
        except cli.MISTAKES as error:
            LOG.error(cli.one_line(PROGRAM, error))
            cli.fail(PROGRAM, error)


def _train(arguments: list[str]) -> None:
    """Run Hydra with a command line."""
    register_sweepers({"halving": (HalvingSweeper, HALVING), "optuna": (OptunaSweeper, asdict(SearchConfig()))})
    register_composition()
    arguments, names = register_tasks(with_folder(expanded(joined(arguments))))
    check_one_task(arguments, names)
    sys.argv[1:] = checked(arguments, registered_data(names))
    try:
        run_hydra(_hydra_main)
    except BaseException:
        tell_failures()  # of a sweeper that gave up
        remove_unused()
        raise


def _body(arguments: list[str]) -> None:
    resume = any(argument.startswith("resume=") for argument in arguments)
    (_resume if resume else _train)(arguments)


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, usage, _body)


if __name__ == "__main__":
    main()
