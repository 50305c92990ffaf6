"""Hyper-parameters of the learner: those of ``ogmp-train``, from ``conf/train.yaml``, and what they may be."""

from __future__ import annotations

import math
import os
import platform
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any

from ogmp_sb3.config.catalogue import PACKAGE
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.plugins import loaded_plugins
from ogmp_sb3.config.strict import check_range, read
from ogmp_sb3.config.yaml_files import read_yaml

RECORDED = ("ogmp_sb3", "mujoco", "torch", "stable-baselines3", "sb3-contrib", "gymnasium", "numpy", "control")
DEFAULTS = PACKAGE / "conf" / "train.yaml"
OURS = ("chunk_length", "learning_rate_half_life", "learn_noise")  # settings that sb3-contrib's class does not have
OF_NETWORK = ("lstm_hidden_size", "n_lstm_layers")
MAX_THREADS = 1024
MAX_SEED = 2**32 - 1  # of numpy's global generator, which Stable-Baselines3 seeds
PPO_RANGES: dict[str, tuple[float, float]] = {
    "n_steps": (1, 1e5),
    "batch_size": (1, math.inf),
    "n_epochs": (1, 1e4),
    "learning_rate": (0, 1),
    "gamma": (0, 1),
    "gae_lambda": (0, 1),
    "ent_coef": (0, math.inf),
    "vf_coef": (0, math.inf),
    "lstm_hidden_size": (1, 4096),
    "n_lstm_layers": (1, 16),
}
"""Least and greatest values; the sizes end where more is a slip of the pen."""


@dataclass(frozen=True, kw_only=True)
class PPOConfig:
    """Hyper-parameters of RecurrentPPO, by sb3-contrib's names, and the size of the network."""

    n_steps: int
    """control steps of each environment in a rollout"""
    batch_size: int
    """samples of a minibatch"""
    n_epochs: int
    """passes over a rollout"""
    learning_rate: float
    """of Adam, at the start"""
    learning_rate_half_life: float | None
    """samples in which the learning rate halves, however long the run; null: it is constant"""
    gamma: float
    """discount factor"""
    gae_lambda: float
    """of generalised advantage estimation"""
    clip_range: float
    """of the probability ratio"""
    target_kl: float | None
    """an update stops early beyond 1.5 times this; null: never"""
    ent_coef: float
    """weight of the entropy bonus"""
    vf_coef: float
    """weight of the value loss"""
    max_grad_norm: float
    """gradients are clipped to this norm"""
    learn_noise: bool
    """whether the exploration noise is learned; false: it stays the task's ``action.noise``"""
    chunk_length: int | None
    """steps of back-propagation through time; null: whole sequences, with the gradients of sb3-contrib"""
    lstm_hidden_size: int
    """of actor and critic"""
    n_lstm_layers: int
    """of actor and critic"""

    def __post_init__(self) -> None:
        for name, (low, high) in PPO_RANGES.items():
            check_range(name, getattr(self, name), low, high)
        for name in ("clip_range", "target_kl", "max_grad_norm"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise ValueError(f"'{name}' must be above 0, found {value:g}.")
        if self.chunk_length is not None and self.chunk_length < 1:
            raise ValueError(f"'chunk_length' must be at least 1 or null, found {self.chunk_length}.")
        if self.learning_rate <= 0:
            raise ValueError(f"'learning_rate' must be above 0, found {self.learning_rate:g}.")
        if self.learning_rate_half_life is not None and self.learning_rate_half_life <= 0:
            raise ValueError(
                f"'learning_rate_half_life' must be above 0 or null, found {self.learning_rate_half_life:g}."
            )

    def settings(self) -> dict[str, Any]:
        """Keyword arguments of :class:`~ogmp_sb3.sb3.recurrent_ppo.RecurrentPPO`."""
        return self.stock_settings() | {name: getattr(self, name) for name in OURS}

    def stock_settings(self) -> dict[str, Any]:
        """Those of them that sb3-contrib's own class has too."""
        return {name: value for name, value in asdict(self).items() if name not in (*OURS, *OF_NETWORK)}


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

    def __post_init__(self) -> None:
        for name in ("total_timesteps", "num_envs", "checkpoint_interval", "keep_checkpoints"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}.")
        if self.policy_average is not None and self.policy_average < 1:
            raise ValueError(f"'policy_average' must be at least 1 or null, found {self.policy_average}.")
        check_range("seed", self.seed, 0, MAX_SEED)
        if self.ppo.n_steps * self.num_envs < 2:
            raise ValueError("'ppo.n_steps' and 'num_envs' are 1: one sample is too few to learn from.")
        for name in ("torch_threads", "physics_threads"):
            setting = getattr(self, name)
            if setting != "auto" and not (isinstance(setting, int) and 1 <= setting <= MAX_THREADS):
                raise ValueError(f"'{name}' must be auto or a whole number from 1 to {MAX_THREADS}, found {setting!r}.")


def default_ppo() -> PPOConfig:
    """The hyper-parameters ``ogmp-train`` uses."""
    return read(PPOConfig, read_yaml(DEFAULTS)["ppo"], Where(str(DEFAULTS), "ppo"))


def thread_count(setting: str | int) -> int:
    """A number of threads, ``auto`` meaning one for each CPU this process may use."""
    return len(os.sched_getaffinity(0)) if setting == "auto" else int(setting)


def versions() -> dict[str, str]:
    """What a run's numbers depend on."""
    found = {}
    for name in RECORDED:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    found |= {plugin.distribution: plugin.version for plugin in loaded_plugins()}
    return {"python": platform.python_version(), "machine": platform.machine(), **found}
