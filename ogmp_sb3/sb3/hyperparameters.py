"""Hyper-parameters of the learner: the defaults of ``ogmp-train`` (``conf/train.yaml``), and their allowed ranges."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from ogmp_sb3.config.catalogue import PACKAGE
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import check_range, read
from ogmp_sb3.config.yaml_files import read_yaml

DEFAULTS = PACKAGE / "conf" / "train.yaml"
# Settings of our learner that sb3-contrib's does not have, of the network, and of what is asked of the environments.
OURS = ("asymmetric_noise", "chunk_length", "critic_max_grad_norm", "learning_rate_half_life", "learn_noise")
OF_NETWORK = ("critic_layers", "input_layers", "lstm_hidden_size", "n_lstm_layers")
OF_ENVIRONMENT = ("symmetry",)
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
    critic_max_grad_norm: float | None = None
    """the critic's gradients are clipped to this norm, the actor's to ``max_grad_norm``; null: together to that"""
    learn_noise: bool
    """whether the exploration noise is learned; false: it stays the task's ``action.noise``"""
    chunk_length: int | None
    """steps of back-propagation through time; null: whole sequences, with the gradients of sb3-contrib"""
    lstm_hidden_size: int
    """of actor and critic"""
    n_lstm_layers: int
    """of actor and critic"""
    input_layers: tuple[int, ...] = ()
    """units of the fully connected layers (ELU) in front of the LSTMs; older runs have none"""
    critic_layers: tuple[int, ...] | None = None
    """units of the fully connected layers (ELU) of a critic without memory; null: the critic is like the actor"""
    symmetry: bool = False
    """whether the policy is made left-right symmetric, so that every sample counts for both sides; older runs: not"""
    asymmetric_noise: float = 1.0
    """with ``symmetry``: exploration noise that is opposite on both sides, as a multiple of what is the same on both"""

    def __post_init__(self) -> None:
        for name, (low, high) in PPO_RANGES.items():
            check_range(name, getattr(self, name), low, high)
        if self.critic_layers == ():
            raise ValueError("'critic_layers' must name at least one layer, or be null for a critic like the actor.")
        for name in ("input_layers", "critic_layers"):
            for units in getattr(self, name) or ():
                check_range(name, units, *PPO_RANGES["lstm_hidden_size"])
        for name in ("clip_range", "target_kl", "max_grad_norm", "critic_max_grad_norm"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise ValueError(f"'{name}' must be above 0, found {value:g}.")
        if self.chunk_length is not None and self.chunk_length < 1:
            raise ValueError(f"'chunk_length' must be at least 1 or null, found {self.chunk_length}.")
        if self.asymmetric_noise <= 0:
            raise ValueError(f"'asymmetric_noise' must be above 0, found {self.asymmetric_noise:g}.")
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
        return {
            name: value for name, value in asdict(self).items() if name not in (*OURS, *OF_NETWORK, *OF_ENVIRONMENT)
        }


def default_ppo() -> PPOConfig:
    """The hyper-parameters ``ogmp-train`` uses."""
    return read(PPOConfig, read_yaml(DEFAULTS)["ppo"], Where(str(DEFAULTS), "ppo"))
