"""RecurrentPPO as in sb3-contrib, with the LSTM called once per batch and time-outs bootstrapped together.

The algorithm is unchanged; what is fast is how sequences reach the LSTM.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv
from torch import nn


class Normaliser(BaseFeaturesExtractor):
    """Running mean and standard deviation of the observations, kept inside the policy.

    It starts at mean 0 and the given scale, and never divides by less than the scale: terrain heights that hardly
    vary in early training must not blow up when a block comes into sight.

    :param observation_space: a flat box
    :param scale: typical size of each component, in its unit; None: 1e-2 each
    :param clip: normalised observations are clipped to this
    """

    mean: th.Tensor
    variance: th.Tensor
    count: th.Tensor
    floor: th.Tensor

    def __init__(self, observation_space: spaces.Box, scale: Sequence[float] | None = None, clip: float = 10.0) -> None:
        size = int(np.prod(observation_space.shape))
        super().__init__(observation_space, size)
        floor = th.full((size,), 1e-2) if scale is None else th.as_tensor(scale, dtype=th.float32)
        self.register_buffer("mean", th.zeros(size))
        self.register_buffer("variance", floor**2)
        self.register_buffer("count", th.zeros(()))
        self.register_buffer("floor", floor)
        self.clip = clip

    def forward(self, observations: th.Tensor) -> th.Tensor:
        std = th.maximum(self.variance.sqrt(), self.floor)
        return ((observations.flatten(1) - self.mean) / std).clamp(-self.clip, self.clip)

    def update(self, observations: th.Tensor) -> None:
        """Take a batch of observations into the statistics (Chan et al. 1979), shape (n, size)."""
        n, total = len(observations), self.count + len(observations)
        delta = observations.mean(dim=0) - self.mean
        variance = observations.var(dim=0, unbiased=False)
        self.variance.copy_((self.count * self.variance + n * variance + delta**2 * self.count * n / total) / total)
        self.mean.add_(delta * n / total)
        self.count.copy_(total)


class LstmPolicy(RecurrentActorCriticPolicy):
    """``MlpLstmPolicy`` whose LSTM runs once over a batch of sequences.

    sb3-contrib steps through time in Python whenever a minibatch holds an episode start. But its sequences are cut
    at episode starts, so a start can only be their first step: zeroing the initial state of those sequences and
    calling the LSTM once is exact.
    """

    @staticmethod
    def _process_sequence(
        features: th.Tensor,
        lstm_states: tuple[th.Tensor, th.Tensor],
        episode_starts: th.Tensor,
        lstm: nn.LSTM,
    ) -> tuple[th.Tensor, tuple[th.Tensor, th.Tensor]]:
        sequences = lstm_states[0].shape[1]
        starts = episode_starts.reshape(sequences, -1)
        length = starts.shape[1]
        if length > 1 and bool((starts[:, 1:] != 0).any()):
            return RecurrentActorCriticPolicy._process_sequence(  # type: ignore[return-value]
                features, lstm_states, episode_starts, lstm
            )
        keep = (1.0 - starts[:, 0]).view(1, sequences, 1)
        inputs = features.reshape(sequences, length, lstm.input_size).transpose(0, 1)
        output, states = lstm(inputs, (lstm_states[0] * keep, lstm_states[1] * keep))
        return output.transpose(0, 1).flatten(0, 1), states


class RecurrentPPO(StockRecurrentPPO):
    """Drop-in for ``sb3_contrib.RecurrentPPO``: same constructor, ``learn``, ``predict``, ``save`` and ``load``.

    ``policy="MlpLstmPolicy"`` names :class:`LstmPolicy`. A :class:`Normaliser` as features extractor is updated
    between rollouts.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        **StockRecurrentPPO.policy_aliases,
        "MlpLstmPolicy": LstmPolicy,
    }

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """As sb3-contrib's, with the values of all time-outs of a step computed in one call."""
        assert self._last_obs is not None, "No previous observation was provided"
        assert not self.use_sde, "State-dependent exploration is not supported"
        self._update_normaliser(rollout_buffer)
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        callback.on_rollout_start()
        lstm_states = self._last_lstm_states

        for _ in range(n_rollout_steps):
            with th.no_grad():
                observation = th.as_tensor(self._last_obs, device=self.device)
                starts = th.as_tensor(self._last_episode_starts, dtype=th.float32, device=self.device)
                actions, values, log_probs, lstm_states = self.policy(observation, lstm_states, starts)
            actions = actions.cpu().numpy()
            clipped = actions
            if isinstance(self.action_space, spaces.Box):
                clipped = np.clip(actions, self.action_space.low, self.action_space.high)
            new_obs, rewards, dones, infos = env.step(clipped)
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            if isinstance(self.action_space, spaces.Discrete):
                actions = actions.reshape(-1, 1)
            self._bootstrap_time_outs(rewards, dones, infos, lstm_states)
            rollout_buffer.add(  # type: ignore[call-arg]
                self._last_obs,  # type: ignore[arg-type]
                actions,
                rewards,
                self._last_episode_starts,  # type: ignore[arg-type]
                values,
                log_probs,
                lstm_states=self._last_lstm_states,
            )
            self._last_obs, self._last_episode_starts, self._last_lstm_states = new_obs, dones, lstm_states  # type: ignore[assignment]

        with th.no_grad():
            last = th.as_tensor(new_obs, device=self.device)
            starts = th.as_tensor(dones, dtype=th.float32, device=self.device)
            values = self.policy.predict_values(last, lstm_states.vf, starts)  # type: ignore[union-attr,call-arg,arg-type]
        rollout_buffer.compute_returns_and_advantage(last_values=values, dones=dones)
        callback.on_rollout_end()
        return True

    def _bootstrap_time_outs(
        self, rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]], lstm_states: RNNStates
    ) -> None:
        """Add the discounted value of the last state to the rewards of episodes that only ran out of time.

        See https://github.com/DLR-RM/stable-baselines3/issues/633.
        """
        rows = [i for i in np.flatnonzero(dones) if infos[i].get("TimeLimit.truncated", False)]
        if not rows:
            return
        terminal = th.as_tensor(np.stack([infos[i]["terminal_observation"] for i in rows]), device=self.device)
        states = tuple(state[:, rows].contiguous() for state in lstm_states.vf)
        with th.no_grad():
            values = self.policy.predict_values(terminal, states, th.zeros(len(rows), device=self.device))  # type: ignore[call-arg,arg-type]
        rewards[rows] += self.gamma * values.flatten().cpu().numpy()

    def _update_normaliser(self, rollout_buffer: RolloutBuffer) -> None:
        """Learn from the last rollout's observations, after its update, so that ratios stay exact."""
        extractor = self.policy.features_extractor
        if isinstance(extractor, Normaliser) and rollout_buffer.full:
            observations = rollout_buffer.observations.reshape(-1, extractor.mean.shape[0])
            extractor.update(th.as_tensor(observations, device=self.device))
