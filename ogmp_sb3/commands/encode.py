"""``ogmp-encode``: train the encoder that turns a task's references into a mode latent."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch as th

from ogmp_sb3.commands import cli
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.encoder_training import (
    fit,
    nearest_mode_accuracy,
    reconstruction_error,
    reference_data,
    save_encoder,
)
from ogmp_sb3.guidance.latent import load_encoder
from ogmp_sb3.report.plots.guidance import plot_latents
from ogmp_sb3.runs.callbacks import progress_bar
from ogmp_sb3.runs.logs import TensorBoardWriter
from ogmp_sb3.runs.settings import versions

PROGRAM = "ogmp-encode"
HELD_OUT = 200  # references of each mode that are kept from training
LOG_EVERY = 100  # updates between two points in TensorBoard


@dataclass(frozen=True, kw_only=True)
class EncodeConfig:
    """Keys of the command line."""

    task: str = cli.option("a task by name or the path of a YAML file")
    out: str | None = cli.option("directory to write; null: encoders/<task>, where it is found by name", None)
    references: int = cli.option("references of each mode", 2000)
    updates: int = cli.option("minibatches of the training", 40_000)
    seed: int = cli.option("same seed, same encoder", 0)

    def __post_init__(self) -> None:
        for name in ("references", "updates"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}.")
        if self.seed < 0:
            raise ValueError(f"'seed' must be at least 0, found {self.seed}.")


HELP = cli.usage(
    PROGRAM,
    "train the auto-encoder of a task's references; its latent is the observation 'mode_latent'.",
    ["ogmp-encode task=parkour", "ogmp-encode task=dive out=my_encoder updates=2000 seed=1"],
    EncodeConfig,
    "any other key of the task file, e.g. modes.pace.v=[0.4,1.4]",
)


def _run(arguments: list[str]) -> None:
    config, overrides = cli.parse(EncodeConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    task = load_task(config.task, overrides)
    out = Path(config.out) if config.out else Path("encoders") / task.name
    cli.check_out(out)
    out.mkdir(parents=True, exist_ok=True)
    th.set_num_threads(1)  # the network is too small for more

    data = reference_data(task, config.references, config.seed)
    held_out = reference_data(task, HELD_OUT, config.seed + 1)
    with closing(TensorBoardWriter(out)) as writer, progress_bar(config.updates, "update") as bar:

        def report(update: int, loss: float) -> None:
            bar.update()
            if update % LOG_EVERY == 0:
                writer.write({"encoder/unexplained_variance": loss}, {}, update)

        model = fit(data, config.updates, config.seed, report)
    error = reconstruction_error(model, held_out)
    settings = {"seed": config.seed, "references": config.references, "updates": config.updates}
    save_encoder(model, out, {"task": task.name, **settings, **versions()})

    encoder = load_encoder(str(out))
    latents, tests = encoder(data.state, data.steps), encoder(held_out.state, held_out.steps)
    modes = [call.name for call in data.calls]
    accuracy = nearest_mode_accuracy(latents, modes, tests, [call.name for call in held_out.calls])
    plot_latents(tests, held_out.calls, out / "latents.png")
    console = cli.console()
    console.print(f"Held-out references: {error:.1%} of the variance is not explained (predicting the mean: 100 %).")
    console.print(f"Nearest neighbour in the latent is of the same mode: {accuracy:.1%}.")
    console.print(f"{out}: spread of the latents {np.ptp(tests, axis=0).round(2)}, picture in latents.png")


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
