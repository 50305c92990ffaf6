"""``ogmp-encode``: train the encoder that turns a task's references into a mode latent."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch as th

from ogmp_sb3.commands import cli
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.encoder_scope import TRAINED_ON, scope
from ogmp_sb3.guidance.encoder_training import HIDDEN, fit, latent_quality, save_encoder
from ogmp_sb3.guidance.latent import LATENT_SIZE, load_encoder
from ogmp_sb3.guidance.reference_data import reference_data
from ogmp_sb3.report.plots.guidance import plot_latents
from ogmp_sb3.runs.callbacks import progress_bar
from ogmp_sb3.runs.logs import TensorBoardWriter
from ogmp_sb3.runs.settings import versions

PROGRAM = "ogmp-encode"
HELD_OUT = 2000  # references of courses that are kept from training; not more than it gets
LOG_EVERY = 100  # updates between two points in TensorBoard


@dataclass(frozen=True, kw_only=True)
class EncodeConfig:
    """Keys of the command line."""

    task: str = cli.option("a task by name or the path of a YAML file")
    out: str | None = cli.option("directory to write; null: encoders/<task>, where it is found by name", None)
    references: int = cli.option("references that are drawn along random courses", 20_000)
    updates: int = cli.option("minibatches of the training", 8_000)
    latent_size: int = cli.option("how many numbers the latent is; the paper has 2", LATENT_SIZE)
    seed: int = cli.option("same seed, same encoder", 0)

    def __post_init__(self) -> None:
        for name in ("references", "updates"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}.")
        if not 2 <= self.latent_size <= HIDDEN:
            raise ValueError(f"'latent_size' must be at least 2 and at most {HIDDEN}, found {self.latent_size}.")
        if self.seed < 0:
            raise ValueError(f"'seed' must be at least 0, found {self.seed}.")


HELP = cli.usage(
    PROGRAM,
    "train the auto-encoder of a task's references; its latent is the observation 'mode_latent'.",
    [
        "ogmp-encode task=parkour",
        "ogmp-encode task=dive out=my_encoder updates=2000 seed=1",
        "ogmp-encode task=parkour latent_size=4 out=encoders/parkour4",
    ],
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

    first, second = np.random.SeedSequence(config.seed).spawn(2)
    data = reference_data(task, config.references, first)
    number = min(HELD_OUT, config.references)
    held_out = reference_data(replace(task, curriculum=None), number, second)  # what a trained policy asks for
    with closing(TensorBoardWriter(out)) as writer, progress_bar(config.updates, "update") as bar:

        def report(update: int, loss: float) -> None:
            bar.update()
            if update % LOG_EVERY == 0:
                writer.write({"encoder/unexplained_variance": loss}, {}, update)

        model = fit(data, config.updates, config.seed, config.latent_size, report)
    quality = latent_quality(model, data, held_out)
    settings = {"seed": config.seed, "references": config.references, "updates": config.updates}
    measured = {"held_out": asdict(quality), TRAINED_ON: scope(task)}
    save_encoder(model, out, {"task": task.name, **settings, **measured, **versions()})

    latents = load_encoder(str(out))(held_out.state, held_out.steps)
    plot_latents(latents, held_out.calls, out / "latents.png")
    console = cli.console()
    console.print(f"On {number:,} references of courses that were held out, {quality}.")
    console.print(f"{out}: spread of the latents {np.ptp(latents, axis=0).round(2)}, picture in latents.png")


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
