"""``ogmp-export``: a policy as ONNX, with all that a controller elsewhere needs to know about it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.export.bundle import (
    ENCODER,
    PARITY_REFERENCES,
    PARITY_STEPS,
    _check,
    encoder_parity,
    export,
    parity,
)
from ogmp_sb3.commands.named_run import RUN, named_run
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.sb3.policy import Normaliser

if TYPE_CHECKING:
    pass

PROGRAM = "ogmp-export"


@dataclass(frozen=True, kw_only=True)
class ExportConfig:
    """Keys of the command line."""

    run: str = cli.option(RUN)
    out: str = cli.option("directory to write")
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)
    task: str | None = cli.option(cli.ZIP_TASK, None)


HELP = cli.usage(
    PROGRAM,
    "write a policy as ONNX, with its observations, actions and gains as JSON and an example controller.",
    ["ogmp-export run=runs/parkour/2026-01-31_12-00-00 out=exported", "ogmp-export run=parkour out=exported"],
    ExportConfig,
)


def _run(arguments: list[str]) -> None:
    config, _ = cli.parse(ExportConfig, arguments, PROGRAM)
    cli.require("export", "onnx", "onnxruntime")
    from ogmp_sb3.commands.export.controller import Controller

    run, out = named_run(PROGRAM, config.run), Path(config.out)
    loaded = load_policy(run, config.trust, config.task, config.robot)
    cli.check_out(out)
    if not isinstance(loaded.policy.features_extractor, Normaliser) or loaded.policy.net_arch:
        raise ValueError(f"'{config.run}': only a network as ogmp-train makes it (Normaliser, LSTM) can be exported.")
    env = BatchEnv(loaded.task.for_evaluation(), num_envs=1, threads=1)
    out.mkdir(parents=True, exist_ok=True)
    # Out of sight until it is known to be right: what lies in 'out' may drive a robot.
    with tempfile.TemporaryDirectory(dir=out, prefix=".") as folder:
        export(loaded, env, Path(folder))
        difference, seconds = parity(loaded, env, Controller(folder))
        _check("actor", difference)
        report = [f"Actions over {PARITY_STEPS} steps differ from PyTorch's by at most {difference:.1e}."]
        if loaded.task.for_evaluation().uses_latent:
            difference = encoder_parity(loaded, Path(folder) / ENCODER)
            _check("encoder", difference)
            report.append(f"Latents of {PARITY_REFERENCES} references differ by at most {difference:.1e}.")
        files = sorted(Path(folder).iterdir())
        (out / ENCODER).unlink(missing_ok=True)  # of another policy
        for file in files:
            file.replace(out / file.name)
    median, slow = 1e3 * np.quantile(seconds, (0.5, 0.99))
    report.append(f"One step on one thread: median {median:.3f} ms, 99th percentile {slow:.3f} ms.")
    cli.console().print("\n".join([f"{out}: {', '.join(file.name for file in files)}", *report]))


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
