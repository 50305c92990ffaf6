"""Settings of a training beside its task: number of environments, threads, intervals; and the versions it ran with."""

from __future__ import annotations

import platform
import re
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any

import torch as th

from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.plugins import loaded_plugins
from ogmp_sb3.config.strict import check_range
from ogmp_sb3.machine import cpu_count
from ogmp_sb3.sb3.hyperparameters import PPOConfig

RECORDED = ("ogmp_sb3", "mujoco", "torch", "stable-baselines3", "sb3-contrib", "gymnasium", "numpy", "control")
TENSORBOARD = "tensorboard"
TRACKERS = (TENSORBOARD, "wandb", "mlflow", "trackio")
MAX_THREADS = 1024
DEVICES = r"cpu|auto|cuda(:\d{1,3})?"
MAX_SEED = 2**32 - 1  # of numpy's global generator, which Stable-Baselines3 seeds


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Everything about a run but its task."""

    seed: int
    """of the networks; environment i is seeded with seed + i"""
    total_timesteps: int
    """samples of the whole run"""
    num_envs: int
    """environments stepped together"""
    checkpoint_interval: int
    """samples between checkpoints"""
    keep_checkpoints: int
    """how many are kept, beside the best policy"""
    policy_average: int | None
    """the policy that is kept has its weights averaged over so many samples; null: the last weights"""
    torch_threads: str | int
    """auto: one for each CPU"""
    physics_threads: str | int
    """auto: one for each CPU"""
    ppo: PPOConfig
    """the learner"""
    device: str = "cpu"
    """where the networks are: cpu, cuda, cuda:<number>, or auto (a CUDA device if there is one)"""
    videos: int | None = None
    """samples between short videos of the policy in the run's videos/, which need the extra viewer; null: none"""
    logger: str | tuple[str, ...] | None = TENSORBOARD
    """where the log goes beside progress.csv: tensorboard, wandb, mlflow, trackio, or several, [a,b]; null: nowhere"""

    def __post_init__(self) -> None:
        for name in ("total_timesteps", "num_envs", "checkpoint_interval", "keep_checkpoints"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}.")
        if self.policy_average is not None and self.policy_average < 1:
            raise ValueError(f"'policy_average' must be at least 1 or null, found {self.policy_average}.")
        if self.videos is not None and self.videos < 1:
            raise ValueError(f"'videos' must be at least 1 or null, found {self.videos}.")
        check_range("seed", self.seed, 0, MAX_SEED)
        if self.ppo.n_steps * self.num_envs < 2:
            raise ValueError("'ppo.n_steps' and 'num_envs' are 1: one sample is too few to learn from.")
        if not re.fullmatch(DEVICES, self.device):
            raise ValueError(f"'device' must be cpu, cuda, cuda:<number> or auto, found {self.device!r}.")
        for name in ("torch_threads", "physics_threads"):
            setting = getattr(self, name)
            if setting != "auto" and not (isinstance(setting, int) and 1 <= setting <= MAX_THREADS):
                raise ValueError(f"'{name}' must be auto or a whole number from 1 to {MAX_THREADS}, found {setting!r}.")

        for name in self.trackers:
            if name not in TRACKERS:
                raise ValueError(f"'logger' is {name!r}{did_you_mean(name, [*TRACKERS, 'null'])}")
            if self.trackers.count(name) > 1:
                raise ValueError(f"'logger' names {name} twice.")

    @property
    def trackers(self) -> tuple[str, ...]:
        """Names of the trackers."""
        names = () if self.logger is None else self.logger
        return (names,) if isinstance(names, str) else names

    def as_data(self) -> dict[str, Any]:
        """Plain data, as in the files."""
        return asdict(self, dict_factory=lambda items: {k: list(v) if isinstance(v, tuple) else v for k, v in items})


def thread_count(setting: str | int) -> int:
    """A number of threads, ``auto`` meaning one for each CPU this process may use."""
    return cpu_count() if setting == "auto" else int(setting)


def torch_device(setting: str) -> str:
    """The device that a setting means here.

    :raises ValueError: if there is none
    """
    there = th.cuda.device_count() if th.cuda.is_available() else 0
    if setting == "auto":
        return "cuda" if there else "cpu"
    if setting != "cpu" and int(setting.partition(":")[2] or 0) >= there:
        found = f"{there} of them" if there else "none"
        raise ValueError(
            f"'device' is {setting}, but of CUDA devices PyTorch finds {found} here; cpu and auto are there."
        )
    return setting


def versions() -> dict[str, str]:
    """Versions of the packages that a run's numbers depend on."""
    installed = {}
    for name in RECORDED:
        try:
            installed[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    installed |= {plugin.distribution: plugin.version for plugin in loaded_plugins()}
    return {"python": platform.python_version(), "machine": platform.machine(), **installed}
