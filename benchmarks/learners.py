"""Learning curves over samples: whole sequences against chunks (three seeds each), and stock RecurrentPPO (one seed).

    python benchmarks/learners.py [out=runs/learners]

All have the environments, the settings and the noise of ``ogmp-train task=parkour``. What was trained already is not
trained again. Leaves ``benchmarks/learners-curves.png`` and the curves as ``benchmarks/curves/learners.csv``.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.logger import Logger

from ogmp_sb3 import make_env, make_model
from ogmp_sb3.report.page import write_csv
from ogmp_sb3.report.panels import mean_curve
from ogmp_sb3.report.plots.trainings import plot_sweep_curves
from ogmp_sb3.runs.callbacks import EpisodeStatistics, ProgressBar
from ogmp_sb3.runs.logs import CsvWriter, TensorBoardWriter
from ogmp_sb3.runs.multirun import read_sweep
from ogmp_sb3.runs.run_directory import Run, read_run

HERE = Path(__file__).parent
CHUNK, SEEDS, SAMPLES, STOCK_SAMPLES = 16, 3, 1_000_000, 300_000
NAMES = {None: "whole sequences", CHUNK: f"chunks of {CHUNK}"}


def train_ours(folder: Path) -> list[Run]:
    """Both modes with every seed, one job on each CPU."""
    seeds = ",".join(map(str, range(SEEDS)))
    swept = ["task=parkour", f"ppo.chunk_length=null,{CHUNK}", f"seed={seeds}", f"total_timesteps={SAMPLES}"]
    jobs = ["hydra/launcher=joblib", "torch_threads=1", "physics_threads=1", f"hydra.sweep.dir={folder}"]
    subprocess.run([sys.executable, "-m", "ogmp_sb3.commands.train.program", "-m", *swept, *jobs], check=True)
    return read_sweep(folder)


def train_stock(folder: Path, num_envs: int = 64, every: int = 16_384) -> Run:
    """sb3-contrib's own RecurrentPPO on the same batch of environments."""
    log = folder / "progress.csv"
    if not log.is_file() or read_run(folder).samples < STOCK_SAMPLES:
        folder.mkdir(parents=True, exist_ok=True)
        model = make_model(make_env("parkour", num_envs), kind=StockRecurrentPPO)
        model.set_logger(Logger(str(folder), [CsvWriter(log), TensorBoardWriter(folder)]))
        callbacks = CallbackList([EpisodeStatistics(every), ProgressBar(STOCK_SAMPLES)])
        model.learn(STOCK_SAMPLES, callback=callbacks, log_interval=None)
        model.logger.close()
    return read_run(folder)


def main() -> None:
    """Train what is missing, and draw."""
    given = dict(argument.partition("=")[::2] for argument in sys.argv[1:])
    folder = Path(given.pop("out", "runs/learners"))
    if given:
        raise SystemExit(f"learners.py: unknown argument '{next(iter(given))}'; the only one is out=<directory>.")
    ours = train_ours(folder / "ours")
    lines = {name: [job for job in ours if job.setting("ppo.chunk_length") == length] for length, name in NAMES.items()}
    lines["stock"] = [train_stock(folder / "stock")]
    rows: list[dict[str, Any]] = []
    for line, runs in lines.items():
        curve = mean_curve(runs, "episode/return")
        points = zip(*curve.values(), strict=True)
        rows += [{"panel": "", "line": line, **dict(zip(curve, point, strict=True))} for point in points]
    write_csv(HERE / "curves" / "learners.csv", rows)
    plot_sweep_curves(rows, "learner", HERE / "learners-curves.png")


if __name__ == "__main__":
    main()
