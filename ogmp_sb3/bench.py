"""``ogmp-bench``: how fast simulation, learner and whole training are, side by side with the alternatives."""

from __future__ import annotations

import gc
import platform
import resource
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch as th
from rich.table import Table
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from ogmp_sb3 import cli
from ogmp_sb3.bench_physics import bench_physics
from ogmp_sb3.bench_sim import Numbers, bench_sim, median, seconds_of, stock_env
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.scenes import TRAINING_ONLY, task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.report.plots.evaluations import plot_throughput
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.settings import thread_count, versions
from ogmp_sb3.runs.storage import save_json
from ogmp_sb3.sb3.hyperparameters import PPOConfig, default_ppo
from ogmp_sb3.sb3.policy import policy_kwargs
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

PROGRAM = "ogmp-bench"
FASTEST_CHUNK = 16  # steps: the fastest chunks on two cores


@dataclass(frozen=True, kw_only=True)
class BenchConfig:
    """Keys of the command line."""

    what: Literal["sim", "learner", "train", "physics"] = cli.option(
        "sim, learner, train or physics; the key may be left out"
    )
    task: str | None = cli.option("a task by name or the path of a YAML file; null: parkour, or that of 'run'", None)
    num_envs: int = cli.option("environments of the comparison", 64)
    steps: int = cli.option("control steps (sim) or samples (train) of one repeat; 0: 150, or four rollouts", 0)
    repeats: int = cli.option("repeats; medians are reported", 5)
    run: str | None = cli.option("physics: policy whose motions on its task are replayed; null: noise", None)
    trust: bool = cli.option(cli.TRUST, False)
    json: str | None = cli.option("file for the numbers; a picture of them is put beside it", None)

    def __post_init__(self) -> None:
        for name in ("num_envs", "repeats"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}.")
        if self.run and self.what != "physics":
            raise ValueError(f"'run' is for 'physics' alone, not for '{self.what}'.")
        if self.steps and self.what in ("learner", "physics"):
            raise ValueError(f"'steps' is for 'sim' and 'train', not for '{self.what}'.")
        if self.steps < 0:
            raise ValueError(f"'steps' must be at least 0 (0: a default), found {self.steps}.")


HELP = cli.usage(
    PROGRAM,
    "measure speed as ratios within one run, medians over repeats.",
    [
        "ogmp-bench sim",
        "ogmp-bench learner json=learner.json",
        "ogmp-bench train steps=8192 repeats=3",
        "ogmp-bench physics run=runs/parkour/2026-01-31_12-00-00",
    ],
    BenchConfig,
)


def bench_learner(task: TaskConfig, num_envs: int, repeats: int) -> Numbers:
    """``train()`` on the same rollout: stock, ours with stock's gradients, ours with chunks."""
    recipe = default_ppo()
    env = OgmpVecEnv(task, num_envs, seed=0)
    learners = {
        "stock": _learner(StockRecurrentPPO, env, recipe, None),
        "exact": _learner(RecurrentPPO, env, recipe, None),
        "chunked": _learner(RecurrentPPO, env, recipe, FASTEST_CHUNK),
    }
    seconds: dict[str, list[float]] = {name: [] for name in learners}
    for _ in range(repeats):
        for name, learner in learners.items():
            _, callback = learner._setup_learn(10**9, reset_num_timesteps=False)
            learner.collect_rollouts(env, callback, learner.rollout_buffer, learner.n_steps)
            seconds[name].append(seconds_of(learner.train))
    each = {name: median(values) for name, values in seconds.items()}
    samples = recipe.n_steps * num_envs
    return {
        "learner_exact_over_stock": each["stock"] / each["exact"],
        "learner_over_stock": each["stock"] / each["chunked"],
        **{f"{name}_samples_per_second": samples / value for name, value in each.items()},
    }


def _learner(kind: type[StockRecurrentPPO], env: VecEnv, recipe: PPOConfig, chunk_length: int | None) -> Any:
    settings = recipe.stock_settings()
    if kind is not StockRecurrentPPO:
        settings["chunk_length"] = chunk_length
    batch = env.batch if isinstance(env, OgmpVecEnv) else None
    size = env.observation_space.shape[0]  # type: ignore[index]
    scale = batch.observation_scale if batch is not None else np.ones(size)
    network = policy_kwargs(scale, recipe.lstm_hidden_size, recipe.n_lstm_layers, log_std_init=-2.5)
    if kind is StockRecurrentPPO:
        del network["optimizer_kwargs"]  # its own: Adam, not fused
    # No early stop, so that all do the recipe's epochs.
    settings["target_kl"] = None
    learner = kind("MlpLstmPolicy", env, seed=0, device="cpu", policy_kwargs=network, **settings)
    learner.set_logger(Logger(None, []))
    return learner


def bench_train(task: TaskConfig, num_envs: int, steps: int, repeats: int) -> Numbers:
    """Whole training against stock RecurrentPPO on a SubprocVecEnv of the same environment, same settings.

    :param steps: samples of one repeat, in whole rollouts; 0: four rollouts
    """
    recipe = default_ppo()
    rollout = recipe.n_steps * num_envs
    samples = max(steps or 4 * rollout, rollout) // rollout * rollout
    ours_env = OgmpVecEnv(task, num_envs, seed=0)
    ours = _learner(RecurrentPPO, ours_env, recipe, recipe.chunk_length)
    with closing(stock_env(SubprocVecEnv, task, num_envs)) as theirs:
        stock = _learner(StockRecurrentPPO, theirs, recipe, None)
        ours_rate, stock_rate = [], []
        for _ in range(repeats):
            ours_rate.append(samples / seconds_of(lambda: ours.learn(samples, reset_num_timesteps=False)))
            stock_rate.append(rollout / seconds_of(lambda: stock.learn(rollout, reset_num_timesteps=False)))
    return {
        "train_over_stock": median(ours_rate) / median(stock_rate),
        "samples_per_second": median(ours_rate),
        "stock_samples_per_second": median(stock_rate),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "memory_mb_per_env": _memory_per_env(task),
    }


def _memory_per_env(task: TaskConfig) -> float:
    """Growth of the resident size from 64 to 1,088 environments, MB each."""

    def resident() -> float:
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20

    small = OgmpVecEnv(task, 64, seed=0)
    before = resident()
    large = OgmpVecEnv(task, 1024, seed=0)
    large.reset()
    grown = resident() - before
    del small, large
    return grown / 1024


def _run(arguments: list[str]) -> None:
    arguments = [a if "=" in a else f"what={a}" for a in arguments]
    config, overrides = cli.parse(BenchConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    th.set_num_threads(thread_count("auto"))
    if config.json:
        Path(config.json).parent.mkdir(parents=True, exist_ok=True)
    if config.run:
        loaded = load_policy(config.run, config.trust, config.task)
        task = task_for_test(loaded.task_data, loaded.task_path, overrides, None, PROGRAM, TRAINING_ONLY)
        numbers = bench_physics(task, loaded.policy, config.num_envs, config.repeats)
    else:
        task = load_task(config.task or "parkour", overrides)
        if config.what == "physics":
            numbers = bench_physics(task, None, config.num_envs, config.repeats)
        elif config.what == "sim":
            numbers = bench_sim(task, config.num_envs, config.steps or 150, config.repeats)
        elif config.what == "learner":
            numbers = bench_learner(task, config.num_envs, config.repeats)
        else:
            numbers = bench_train(task, config.num_envs, config.steps, config.repeats)
    table = Table(title=f"{PROGRAM} {config.what}, {platform.processor() or platform.machine()}", title_justify="left")
    table.add_column("what")
    table.add_column("value", justify="right")
    for name, value in numbers.items():
        table.add_row(name, f"{value:,.3f}" if value < 100 else f"{value:,.0f}")
    cli.console().print(table)
    if config.json:
        cores = thread_count("auto")
        report = {"config": asdict(config), "overrides": overrides, "numbers": numbers, "cores": cores}
        save_json(Path(config.json), {**report, "versions": versions()})
        if any("per_second" in name for name in numbers):
            plot_throughput(f"{PROGRAM} {config.what}, {cores} cores", numbers, Path(config.json).with_suffix(".png"))


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
