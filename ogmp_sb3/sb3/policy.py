"""The recurrent policy: sb3-contrib's, with an observation normaliser, and the LSTM called once per batch."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from torch import nn

LstmStates = tuple[th.Tensor, th.Tensor]


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


def fully_connected(inputs: int, layers: Sequence[int]) -> nn.Sequential:
    """Layers with ELU.

    :param inputs: length of an input
    :param layers: units of each
    """
    sizes = pairwise([inputs, *layers])
    return nn.Sequential(*(part for pair in sizes for part in (nn.Linear(*pair), nn.ELU())))


class LayeredLstm(nn.Module):
    """Fully connected layers with ELU, and an LSTM behind them; called as an ``nn.LSTM`` is.

    :param inputs: length of an input
    :param layers: units of each layer, at least one
    :param hidden_size: of the LSTM
    :param num_layers: of the LSTM
    """

    def __init__(self, inputs: int, layers: Sequence[int], hidden_size: int, num_layers: int) -> None:
        super().__init__()
        self.input_size, self.hidden_size, self.num_layers = inputs, hidden_size, num_layers
        self.layers = fully_connected(inputs, layers)
        self.lstm = nn.LSTM(layers[-1], hidden_size, num_layers)

    def forward(self, inputs: th.Tensor, states: LstmStates) -> tuple[th.Tensor, LstmStates]:
        output: tuple[th.Tensor, LstmStates] = self.lstm(self.layers(inputs), states)
        return output


class LstmPolicy(RecurrentActorCriticPolicy):
    """``MlpLstmPolicy`` whose LSTM runs once over a batch of sequences, and which may have layers in front of it.

    sb3-contrib steps through time in Python whenever a minibatch holds an episode start. But its sequences are cut
    at episode starts, so a start can only be their first step: zeroing the initial state of those sequences and
    calling the LSTM once is exact.

    :param input_layers: units of fully connected layers in front of the LSTMs of actor and critic, each its own
    :param critic_layers: units of the fully connected layers of a critic without memory, which takes
        ``enable_critic_lstm=False`` and no ``net_arch``; None: sb3-contrib's critic
    :param critic_inputs: how many values the critic sees beside the observation, behind it; only
        :class:`~ogmp_sb3.sb3.recurrent_ppo.RecurrentPPO` shows them. The other parameters are those of
        ``MlpLstmPolicy``
    :raises ValueError: if these do not go together
    """

    # sb3-contrib declares these narrower than they are here.
    lstm_actor: Any
    lstm_critic: Any
    critic: Any

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        *args: Any,
        input_layers: Sequence[int] = (),
        critic_layers: Sequence[int] | None = None,
        critic_inputs: int = 0,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, *args, **kwargs)
        self.input_layers, self.critic_inputs = tuple(input_layers), critic_inputs
        self.critic_layers = None if critic_layers is None else tuple(critic_layers)
        seen_by_critic = self.features_dim + critic_inputs
        if input_layers:
            self.lstm_actor = self._memory(self.features_dim)
        if self.critic_layers is not None:
            if self.critic is None or self.net_arch:
                raise ValueError("'critic_layers' needs enable_critic_lstm=False, no shared LSTM and no 'net_arch'.")
            self.critic = fully_connected(seen_by_critic, self.critic_layers)
            self.value_net = nn.Linear(self.critic_layers[-1], 1)
        elif self.lstm_critic is not None:
            if input_layers or critic_inputs:
                self.lstm_critic = self._memory(seen_by_critic)
        elif critic_inputs:
            raise ValueError("'critic_inputs' needs 'critic_layers', or a critic with an LSTM of its own.")
        if input_layers or critic_inputs or self.critic_layers is not None:
            optimizer: Any = self.optimizer_class
            self.optimizer = optimizer(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def critic_weights(self) -> list[nn.Parameter]:
        """The weights that values depend on, and actions do not."""
        parts = (self.lstm_critic, self.critic, self.mlp_extractor.value_net, self.value_net)
        return [weight for part in parts if part is not None for weight in part.parameters()]

    def actor_weights(self) -> list[nn.Parameter]:
        """All others: those that actions depend on."""
        critic = {id(weight) for weight in self.critic_weights()}
        return [weight for weight in self.parameters() if id(weight) not in critic]

    def _memory(self, inputs: int) -> nn.Module:
        """An LSTM of the policy's size, with the layers in front of it."""
        hidden, layers = self.lstm_actor.hidden_size, self.lstm_actor.num_layers
        if self.input_layers:
            return LayeredLstm(inputs, self.input_layers, hidden, layers)
        return nn.LSTM(inputs, hidden, layers, **self.lstm_kwargs)

    @staticmethod
    def _process_sequence(  # type: ignore[override]
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


def policy_kwargs(
    scale: np.ndarray,
    lstm_hidden_size: int,
    n_lstm_layers: int,
    log_std_init: float = 0.0,
    input_layers: Sequence[int] = (),
    critic_layers: Sequence[int] | None = None,
    critic_inputs: int = 0,
) -> dict[str, Any]:
    """LSTMs for actor and critic behind a normaliser, as in the paper, and layers between them if wanted.

    :param scale: typical sizes of the observation's components
    :param input_layers: units of each
    :param critic_layers: units of each layer of a critic without memory; None: the critic is an LSTM, as the actor
    :param critic_inputs: how many values the critic sees beside the observation
    """
    return {
        "net_arch": [],
        **({"input_layers": tuple(input_layers)} if input_layers else {}),  # sb3-contrib's policy has none
        "lstm_hidden_size": lstm_hidden_size,
        "n_lstm_layers": n_lstm_layers,
        "enable_critic_lstm": critic_layers is None,
        **({} if critic_layers is None else {"critic_layers": tuple(critic_layers)}),
        **({"critic_inputs": critic_inputs} if critic_inputs else {}),
        "log_std_init": log_std_init,
        "optimizer_kwargs": {"eps": 1e-5, "fused": True},  # SB3's epsilon; fused is the same in fewer calls
        "features_extractor_class": Normaliser,
        "features_extractor_kwargs": {"scale": [float(s) for s in scale]},
    }
