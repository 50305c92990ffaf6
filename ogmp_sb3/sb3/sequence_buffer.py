"""The rollout of a recurrent policy as whole sequences: no padding to the longest, no stepping through time.

A rollout is cut into sequences at episode starts, environment changes and minibatch edges. A sequence begins with
the stored LSTM state, or with zeros if it begins an episode. Sequences of similar length run through the LSTM
together.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch as th
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from stable_baselines3.common.buffers import RolloutBuffer
from torch import nn

from ogmp_sb3.machine import compiled

STEP_COST = 9.0  # what one more step of the LSTM costs, in samples (measured: LSTM 128, 1 thread)


@dataclass(frozen=True)
class SequenceGroup:
    """Sequences that run through the LSTM together. Indices are into the env-major flattened rollout."""

    steps: th.Tensor
    """transition of each place, shape (length, sequences), int64; places beyond a sequence's end repeat its last"""
    valid: th.Tensor
    """which places count, shape (length, sequences), bool"""
    keep: th.Tensor
    """1 where the first state is the stored one, 0 where an episode begins, shape (sequences, 1)"""
    stored: th.Tensor
    """where the stored state is: saved step * num_envs + environment, shape (sequences,), int64"""


@dataclass(frozen=True)
class Minibatch:
    """A part of the rollout."""

    groups: list[SequenceGroup]
    """its sequences"""
    order: th.Tensor
    """transitions in the order in which the groups give them, shape (n,), int64"""


class SequenceBuffer(RolloutBuffer):
    """SB3's ``RolloutBuffer`` that hands out :class:`Minibatch` instead of padded samples.

    :param chunk_length: None: minibatches and sequences are those of sb3-contrib, so gradients are the same; a
        number: the rollout is cut into chunks of that many steps, which are shuffled anew for every epoch
    """

    chunk_length: int | None = None

    def reset(self) -> None:
        super().reset()
        self.states: list[RNNStates] = []
        self.critic_observations: list[th.Tensor] = []

    def save(self, states: RNNStates, critic_observation: th.Tensor) -> None:
        """Keep what goes with the step that is added next.

        :param states: of the LSTMs in front of it, which are kept if a sequence can begin there
        :param critic_observation: what only the critic sees, shape (num_envs, size)
        """
        if self.chunk_length is None or self.pos % self.chunk_length == 0:
            self.states.append(states)
        self.critic_observations.append(critic_observation)

    def freeze(self) -> None:
        """Make the full rollout ready for :meth:`minibatches`: flat tensors, env-major."""
        self._starts = self.episode_starts.astype(bool)  # (steps, envs)
        self.flat = {
            name: th.as_tensor(_flatten(getattr(self, name)), device=self.device)
            for name in ("observations", "actions", "values", "log_probs", "advantages", "returns")
        }
        self.flat["critic_observations"] = th.stack(self.critic_observations, dim=1).flatten(0, 1)
        self.actor_states = _stack_states([s.pi for s in self.states])
        self.critic_states = _stack_states([s.vf for s in self.states])

    def minibatches(self, batch_size: int) -> Iterator[Minibatch]:
        """One epoch over the rollout.

        :param batch_size: transitions; with chunks, rounded to whole chunks
        """
        steps, envs = self.buffer_size, self.n_envs
        if self.chunk_length is None:
            # Exactly the draw of sb3-contrib: rotate the flat rollout, then cut it.
            split = np.random.randint(steps * envs)
            rotated = np.roll(np.arange(steps * envs), -split)
            for first in range(0, steps * envs, batch_size):
                yield self._minibatch(rotated[first : first + batch_size])
            return
        length = min(self.chunk_length, steps)
        chunks = -(-steps // length) * envs
        shuffled = np.random.permutation(chunks)
        per_batch = max(1, batch_size // length)
        per_env = chunks // envs
        for first in range(0, chunks, per_batch):
            chosen = shuffled[first : first + per_batch]
            begin = (chosen // per_env) * steps + (chosen % per_env) * length
            end = np.minimum(begin + length, (chosen // per_env + 1) * steps)
            yield self._minibatch(np.concatenate([np.arange(b, e) for b, e in zip(begin, end, strict=True)]))

    def _minibatch(self, transitions: np.ndarray) -> Minibatch:
        """Cut transitions, in order, into sequences and group these by length."""
        step, env = transitions % self.buffer_size, transitions // self.buffer_size
        episode_start = self._starts[step, env]
        begins = episode_start.copy()
        begins[0] = True
        begins[1:] |= np.diff(transitions) != 1
        begins |= step == 0
        if self.chunk_length is not None:
            begins |= step % self.chunk_length == 0
        first = np.flatnonzero(begins)
        length = np.diff(np.append(first, len(transitions)))
        padded = padded_lengths(length)
        groups = []
        for bucket in np.unique(padded):
            members = padded == bucket
            place = np.arange(bucket)[:, None]
            index = first[members] + np.minimum(place, length[members] - 1)
            start = first[members]
            saved = step[start] if self.chunk_length is None else step[start] // self.chunk_length
            groups.append(
                SequenceGroup(
                    steps=self._tensor(transitions[index]),
                    valid=self._tensor(place < length[members]),
                    keep=self._tensor(~episode_start[start]).float()[:, None],
                    stored=self._tensor(saved * self.n_envs + env[start]),
                )
            )
        return Minibatch(groups, th.cat([group.steps[group.valid] for group in groups]))

    def _tensor(self, array: np.ndarray) -> th.Tensor:
        return th.from_numpy(array).to(self.device)


def lstm_outputs(
    lstm: nn.LSTM, batch: Minibatch, features: th.Tensor, states: tuple[th.Tensor, th.Tensor]
) -> th.Tensor:
    """Outputs of an LSTM for the transitions ``batch.order``, shape (n, hidden size).

    :param features: of the whole rollout, env-major, shape (envs * steps, size)
    :param states: stored hidden and cell states, each of shape (layers, saved steps * envs, hidden size)
    """
    outputs = []
    for group in batch.groups:
        initial = tuple(state[:, group.stored] * group.keep for state in states)
        output, _ = lstm(features[group.steps], initial)
        outputs.append(output[group.valid])
    return th.cat(outputs)


def _flatten(array: np.ndarray) -> np.ndarray:
    """(steps, envs, ...) to (envs * steps, ...), env-major."""
    return np.ascontiguousarray(array.swapaxes(0, 1)).reshape(-1, *array.shape[2:])


def _stack_states(states: list[tuple[th.Tensor, ...]]) -> tuple[th.Tensor, th.Tensor]:
    """Hidden and cell states, each of shape (layers, saved steps * envs, size)."""
    hidden, cell = (th.stack([s[i] for s in states], dim=1).flatten(1, 2) for i in (0, 1))
    return hidden, cell


def padded_lengths(length: np.ndarray) -> np.ndarray:
    """The length that each sequence is padded to, so that all groups together cost least.

    A group of n sequences padded to T steps costs ``T (STEP_COST + n)``: few groups pad more, many take more steps.

    :param length: shape (sequences,), int, at least 1
    :return: shape (sequences,), int
    """
    values, counts = np.unique(length, return_counts=True)
    ends: np.ndarray = values[_group_ends(values, counts, STEP_COST)]
    return ends[np.searchsorted(values, length)]


@compiled
def _group_ends(values, counts, step_cost):  # type: ignore[no-untyped-def]
    """For each distinct length, the place of the longest of its group (dynamic programming over the last group)."""
    n = len(values)
    cost, first = np.zeros(n + 1), np.zeros(n, dtype=np.int64)
    for end in range(n):
        cost[end + 1] = np.inf
        members = 0
        for begin in range(end, -1, -1):
            members += counts[begin]
            total = cost[begin] + values[end] * (step_cost + members)
            if total < cost[end + 1]:
                cost[end + 1], first[end] = total, begin
    ends = np.empty(n, dtype=np.int64)
    end = n - 1
    while end >= 0:
        ends[first[end] : end + 1] = end
        end = first[end] - 1
    return ends
