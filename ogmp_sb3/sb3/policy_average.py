"""The average of a policy's weights over the last samples of its training.

Every update moves the weights partly by chance. Their average has less of that chance in it than any of them
(Polyak and Juditsky, 1992), while the training itself goes on from the last ones.
"""

from __future__ import annotations

import math

import torch as th
from stable_baselines3.common.callbacks import BaseCallback


class PolicyAverage(BaseCallback):
    """Keeps the average of the weights after each update, exponentially weighted; at first their plain mean.

    :param over: time constant, samples
    """

    def __init__(self, over: int) -> None:
        super().__init__()
        self.over = over
        self.weights: dict[str, th.Tensor] = {}
        self._averaged_at = 0  # samples

    def _on_training_start(self) -> None:
        if not self.weights:
            self.weights = {name: tensor.clone() for name, tensor in self.model.policy.state_dict().items()}
        self._averaged_at = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        self._add()

    def _on_training_end(self) -> None:
        self._add()

    def _add(self) -> None:
        """Add the weights of the last update, if there was one."""
        samples = self.model.num_timesteps - self._averaged_at
        if not samples:
            return
        share = max(-math.expm1(-samples / self.over), samples / self.model.num_timesteps)
        for name, tensor in self.model.policy.state_dict().items():
            self.weights[name].lerp_(tensor, share)
        self._averaged_at += samples

    def _on_step(self) -> bool:
        return True
