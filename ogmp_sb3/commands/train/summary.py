"""What a multirun came to, when it has ended: a table of its jobs, and the command that compares them."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.runs.multirun import read_sweep, setting, swept_keys
from ogmp_sb3.runs.run_directory import RETURN, Run, samples_text


class Summary(Callback):
    """Shows the jobs at the end of a multirun. Hydra calls it (``hydra.callbacks``)."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table, where there is a job; those that failed are told of behind it."""
        folder = Path(config.hydra.sweep.dir)
        try:
            jobs = read_sweep(folder, asked=True)
        except ValueError:  # none has begun
            return
        console = cli.console()
        console.print(summary(jobs))
        console.print(f"To compare them on test tracks:  ogmp-report {shlex.quote(f'sweep={folder}')}")


def summary(jobs: list[Run]) -> Table:
    """The jobs of a multirun: what they differ in, how far they got, and the return of their last training episodes."""
    keys = swept_keys(jobs)
    table = Table(*(keys or ["job"]), "state")
    for column in ("samples", "training return"):
        table.add_column(column, justify="right")
    for job in jobs:
        names = ["null" if (value := setting(job, key)) is None else str(value) for key in keys] or [job.path.name]
        last = job.final(RETURN)
        table.add_row(*names, job.state, samples_text(job.samples), "" if math.isnan(last) else f"{last:.1f}")
    return table
