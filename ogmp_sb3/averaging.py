"""The average of a policy's weights over the last samples of its training.

Every update moves the weights partly by chance. Their average has less of that chance in it than any of them
(Polyak and Juditsky, 1992), while the training itself goes on from the last ones.
"""

from __future__ import annotations

import math

import torch as th
from stable_baselines3.common.callbacks import BaseCallback


class PolicyAverage(BaseCallback):
    """Keeps the average, exponentially weighted; at first it is that of all weights so far.

    :param over: time constant, samples
    """

    def __init__(self, over: int) -> None:
        super().__init__()
        self.over = over
        self.weights: dict[str, th.Tensor] = {}

    def _on_training_start(self) -> None:
        if not self.weights:
            self.weights = {name: tensor.clone() for name, tensor in self.model.policy.state_dict().items()}

    def _on_rollout_end(self) -> None:
        rollout = self.model.n_steps * self.model.n_envs  # type: ignore[attr-defined]
        share = max(-math.expm1(-rollout / self.over), rollout / self.num_timesteps)
        for name, tensor in self.model.policy.state_dict().items():
            self.weights[name].lerp_(tensor, share)

    def _on_step(self) -> bool:
        return True
