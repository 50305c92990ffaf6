"""RecurrentPPO as in sb3-contrib, with the LSTM called once per batch and time-outs bootstrapped together.

The algorithm is unchanged; what is fast is how sequences reach the LSTM.
"""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import explained_variance
from stable_baselines3.common.vec_env import VecEnv

from ogmp_sb3.env.mirror import Mirrors
from ogmp_sb3.sb3.finite_updates import undone_unless_finite
from ogmp_sb3.sb3.policy import LstmPolicy, LstmStates, Normaliser
from ogmp_sb3.sb3.sequence_buffer import Minibatch, SequenceBuffer, lstm_outputs
from ogmp_sb3.sb3.symmetry import SymmetricNoise, Symmetry
from ogmp_sb3.sb3.threads import torch_threads


class RecurrentPPO(StockRecurrentPPO):
    """Drop-in for ``sb3_contrib.RecurrentPPO``: same constructor, ``learn``, ``predict``, ``save`` and ``load``.

    ``policy="MlpLstmPolicy"`` names :class:`LstmPolicy`. A :class:`Normaliser` as features extractor is updated
    after every rollout. Actor and critic are updated side by side in two threads. Policies with a shared LSTM,
    dictionary observations or trainable features extractors train as in sb3-contrib. An update with a loss, gradient,
    weight or standard deviation that is not finite is undone, with a warning.

    A critic with ``critic_inputs`` also sees what the environments say in their attribute ``critic_observation``, and
    in ``infos[i]["terminal_critic_observation"]``.

    :param chunk_length: None: sequences, minibatches and gradients of sb3-contrib; a number: the rollout is cut into
        chunks of that many steps (truncated back-propagation from the stored state), shuffled in every epoch
    :param learning_rate_half_life: samples over which the learning rate halves; None: as in sb3-contrib
    :param learn_noise: whether the exploration noise is learned; False: it stays as it begins
    :param critic_max_grad_norm: the critic's gradients are clipped to this norm, and ``max_grad_norm`` is the actor's
        alone; None: they are clipped together, as in sb3-contrib
    :param mirrors: the mirror images of observations and actions, for a policy that is left-right symmetric
        (:mod:`ogmp_sb3.sb3.symmetry`); None: it need not be
    :param asymmetric_noise: with ``mirrors``, see :class:`~ogmp_sb3.sb3.symmetry.SymmetricNoise`
    :raises ValueError: if a policy of this kind cannot be symmetric, or its critic cannot see more
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        **StockRecurrentPPO.policy_aliases,
        "MlpLstmPolicy": LstmPolicy,
    }
    # SB3 declares these wider than they are here.
    policy: Any
    rollout_buffer: Any
    clip_range: Any
    clip_range_vf: Any
    batch_size: Any
    _last_obs: Any
    _last_episode_starts: Any
    _last_lstm_states: Any

    def __init__(
        self,
        *args: Any,
        chunk_length: int | None = None,
        learning_rate_half_life: int | None = None,
        learn_noise: bool = True,
        critic_max_grad_norm: float | None = None,
        mirrors: Mirrors | None = None,
        asymmetric_noise: float = 1.0,
        **kwargs: Any,
    ) -> None:
        self.chunk_length, self.mirrors, self.asymmetric_noise = chunk_length, mirrors, asymmetric_noise
        self.learning_rate_half_life, self.learn_noise = learning_rate_half_life, learn_noise
        self.critic_max_grad_norm = critic_max_grad_norm
        self.undone_updates = self.undone_in_a_row = 0  # because something was not finite
        super().__init__(*args, **kwargs)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "lr_schedule", "_symmetry"]  # set up anew

    def _setup_lr_schedule(self) -> None:
        super()._setup_lr_schedule()
        half_life, schedule = self.learning_rate_half_life, self.lr_schedule
        if half_life is not None:
            # By samples, not by the share that is done: a run does not depend on how far it will go.
            self.lr_schedule = lambda progress: schedule(progress) * 0.5 ** (self.num_timesteps / half_life)

    def _setup_model(self) -> None:
        super()._setup_model()
        if not self.learn_noise:
            self.policy.log_std.requires_grad_(False)
        self._fast = (
            isinstance(self.policy, LstmPolicy)
            and not self.policy.shared_lstm
            and isinstance(self.observation_space, spaces.Box)
            and not self.use_sde
            and not any(p.requires_grad for p in self.policy.features_extractor.parameters())
        )
        self._critic_inputs = getattr(self.policy, "critic_inputs", 0)
        for name, given in (("mirrors", self.mirrors is not None), ("critic_inputs", self._critic_inputs)):
            if given and not self._fast:
                raise ValueError(f"'{name}' needs an LstmPolicy whose actor and critic share nothing.")
        self._symmetry: Symmetry | None = None
        if self.mirrors is not None:
            self._symmetry = Symmetry(self.policy, self.mirrors)
            self._symmetry.symmetrise_weights()
            self.policy.action_dist = SymmetricNoise(self.mirrors.action, self.asymmetric_noise)
        if self._fast:
            self.rollout_buffer = SequenceBuffer(
                self.n_steps,
                self.observation_space,
                self.action_space,
                self.device,
                gamma=self.gamma,
                gae_lambda=self.gae_lambda,
                n_envs=self.n_envs,
            )
            self.rollout_buffer.chunk_length = self.chunk_length

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """As sb3-contrib's, with the values of all time-outs of a step computed in one call."""
        if not self._fast:
            return super().collect_rollouts(env, callback, rollout_buffer, n_rollout_steps)
        side_by_side = th.get_num_threads() > 1 and self.device.type == "cpu"
        # One step of a small network: more threads than one for each network only wait for each other.
        with torch_threads(1), ThreadPoolExecutor(1, initializer=th.set_num_threads, initargs=(1,)) as pool:
            return self._collect(env, callback, rollout_buffer, n_rollout_steps, pool if side_by_side else None)

    def _collect(
        self,
        env: VecEnv,
        callback: BaseCallback,
        rollout_buffer: RolloutBuffer,
        n_rollout_steps: int,
        pool: Executor | None,
    ) -> bool:
        assert self._last_obs is not None, "No previous observation was provided"
        assert isinstance(rollout_buffer, SequenceBuffer)
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        callback.on_rollout_start()
        lstm_states = self._last_lstm_states

        for _ in range(n_rollout_steps):
            starts = th.as_tensor(self._last_episode_starts, dtype=th.float32, device=self.device)
            features, unseen = self._features(self._last_obs), self._critic_observation(env)
            seen = th.cat([features, unseen], dim=1)
            critic = pool.submit(self._values, seen, lstm_states.vf, starts) if pool else None
            sampled, log_probs, actor_states = self._act(features, lstm_states.pi, starts)
            values, critic_states = critic.result() if critic else self._values(seen, lstm_states.vf, starts)
            lstm_states = RNNStates(actor_states, critic_states)
            actions = sampled.cpu().numpy()
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
            rollout_buffer.save(self._last_lstm_states, unseen)
            rollout_buffer.add(
                self._last_obs,
                actions,
                rewards,
                self._last_episode_starts,
                values,
                log_probs,
            )
            self._last_obs, self._last_episode_starts, self._last_lstm_states = new_obs, dones, lstm_states

        starts = th.as_tensor(dones, dtype=th.float32, device=self.device)
        seen = th.cat([self._features(new_obs), self._critic_observation(env)], dim=1)
        values, _ = self._values(seen, lstm_states.vf, starts)
        rollout_buffer.compute_returns_and_advantage(last_values=values, dones=dones)
        callback.on_rollout_end()
        return True

    @th.inference_mode()
    def _features(self, observation: Any) -> Any:
        return self.policy.extract_features(th.as_tensor(observation, device=self.device))

    def _critic_observation(self, env: VecEnv) -> th.Tensor:
        """What only the critic sees of the environments, shape (num_envs, critic_inputs)."""
        if not self._critic_inputs:
            return th.zeros((env.num_envs, 0), device=self.device)
        return th.as_tensor(env.get_attr("critic_observation", 0)[0], device=self.device)

    @th.inference_mode()
    def _act(
        self, features: th.Tensor, states: LstmStates, starts: th.Tensor
    ) -> tuple[th.Tensor, th.Tensor, LstmStates]:
        """Sampled actions, their log probabilities, and the actor's next states."""
        policy = self.policy
        latent, states = policy._process_sequence(features, states, starts, policy.lstm_actor)
        distribution = policy._get_action_dist_from_latent(policy.mlp_extractor.forward_actor(latent))
        actions = distribution.get_actions()
        return actions.reshape((len(actions), *(self.action_space.shape or ()))), distribution.log_prob(actions), states

    @th.inference_mode()
    def _values(self, features: th.Tensor, states: LstmStates, starts: th.Tensor) -> tuple[th.Tensor, LstmStates]:
        """Values, and the critic's next states.

        :param features: of all that the critic sees, shape (num_envs, size)
        """
        policy = self.policy
        if policy.lstm_critic is None:
            latent = policy.critic(features)
        else:
            latent, states = policy._process_sequence(features, states, starts, policy.lstm_critic)
        return policy.value_net(policy.mlp_extractor.forward_critic(latent)), states

    def _bootstrap_time_outs(
        self, rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]], lstm_states: RNNStates
    ) -> None:
        """Add the discounted value of the last state to the rewards of episodes that only ran out of time.

        See https://github.com/DLR-RM/stable-baselines3/issues/633.
        """
        rows = [int(i) for i in np.flatnonzero(dones) if infos[i].get("TimeLimit.truncated", False)]
        if not rows:
            return
        terminal = self._features(np.stack([infos[i]["terminal_observation"] for i in rows]))
        if self._critic_inputs:
            unseen = np.stack([infos[i]["terminal_critic_observation"] for i in rows])
            terminal = th.cat([terminal, th.as_tensor(unseen, device=self.device)], dim=1)
        states = lstm_states.vf[0][:, rows].contiguous(), lstm_states.vf[1][:, rows].contiguous()
        values, _ = self._values(terminal, states, th.zeros(len(rows), device=self.device))
        rewards[rows] += self.gamma * values.flatten().cpu().numpy()

    def train(self) -> None:
        """sb3-contrib's update; then the normaliser learns from the rollout, so that ratios inside it are exact."""
        with undone_unless_finite(self):
            if not np.isfinite(self.rollout_buffer.rewards).all():
                raise FloatingPointError("a reward of the rollout is not finite.")
            if self._fast:
                self._train_on_sequences()
            else:
                super().train()
            extractor = self.policy.features_extractor
            if isinstance(extractor, Normaliser):
                observations = self.rollout_buffer.observations.reshape(-1, extractor.mean.shape[0])
                observations = th.as_tensor(observations, device=self.device)
                extractor.update(observations if self._symmetry is None else self._symmetry.both_sides(observations))
        self.logger.record("train/undone_updates", self.undone_updates)

    def _train_on_sequences(self) -> None:
        policy, buffer = self.policy, self.rollout_buffer
        assert isinstance(policy, LstmPolicy) and isinstance(buffer, SequenceBuffer)
        policy.set_training_mode(True)
        self._update_learning_rate(policy.optimizer)
        clip_range = self.clip_range(self._current_progress_remaining)
        buffer.freeze()
        with th.no_grad():
            features: Any = policy.extract_features(buffer.flat["observations"])
            seen = th.cat([features, buffer.flat["critic_observations"]], dim=1)
        logs: list[dict[str, th.Tensor]] = []
        side_by_side = th.get_num_threads() > 1 and self.device.type == "cpu"
        each = max(1, th.get_num_threads() // 2) if side_by_side else th.get_num_threads()
        with torch_threads(each), ThreadPoolExecutor(1, initializer=th.set_num_threads, initargs=(each,)) as pool:
            for _ in range(self.n_epochs):
                go_on = self._train_epoch(features, seen, clip_range, pool if side_by_side else None, logs)
                self._n_updates += 1
                if not go_on:
                    break
        self._log_update(logs, clip_range)

    def _train_epoch(
        self,
        features: th.Tensor,
        seen: th.Tensor,
        clip_range: float,
        pool: Executor | None,
        logs: list[dict[str, th.Tensor]],
    ) -> bool:
        """One pass over the rollout; False if the KL divergence stopped it. What is not finite raises.

        :param features: of all that the actor sees
        :param seen: of all that the critic sees
        :param pool: where to update the critic meanwhile; None: here
        """
        policy, buffer = self.policy, self.rollout_buffer
        assert isinstance(buffer, SequenceBuffer)
        for batch in buffer.minibatches(self.batch_size):
            policy.optimizer.zero_grad()
            critic = pool.submit(self._critic_gradients, batch, seen) if pool else None
            log, kl = self._actor_gradients(batch, features, clip_range)
            value_loss = critic.result() if critic else self._critic_gradients(batch, seen)
            if self._symmetry is not None:
                self._symmetry.symmetrise_gradients()
            norm = self._clip_gradients()
            if not th.isfinite(th.stack([norm, log["policy_gradient_loss"], value_loss])).all():
                losses = f"policy loss {log['policy_gradient_loss']:g}, value loss {value_loss:g}"
                raise FloatingPointError(f"a loss or a gradient is not finite ({losses}, gradient {norm:g}).")
            logs.append({**log, "value_loss": value_loss})
            if self.target_kl is not None and kl > 1.5 * self.target_kl:
                return False
            policy.optimizer.step()
        return True

    def _clip_gradients(self) -> th.Tensor:
        """Clip the gradients; returns the norm that they had."""
        clip, policy = th.nn.utils.clip_grad_norm_, self.policy
        if self.critic_max_grad_norm is None:
            return clip(policy.parameters(), self.max_grad_norm)
        actor, critic = policy.actor_weights(), policy.critic_weights()
        return th.hypot(clip(actor, self.max_grad_norm), clip(critic, self.critic_max_grad_norm))

    def _actor_gradients(
        self, batch: Minibatch, features: th.Tensor, clip_range: float
    ) -> tuple[dict[str, th.Tensor], th.Tensor]:
        """Add the gradients of the clipped surrogate and the entropy bonus; returns what to log, and the KL."""
        policy, data = self.policy, self.rollout_buffer.flat
        latent = lstm_outputs(policy.lstm_actor, batch, features, self.rollout_buffer.actor_states)
        distribution = policy._get_action_dist_from_latent(policy.mlp_extractor.forward_actor(latent))
        actions = data["actions"][batch.order]
        if isinstance(self.action_space, spaces.Discrete):
            actions = actions.long().flatten()
        log_prob, entropy = distribution.log_prob(actions), distribution.entropy()
        advantages = data["advantages"][batch.order]
        if self.normalize_advantage and len(advantages) > 1:  # one alone has no deviation
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        log_ratio = log_prob - data["log_probs"][batch.order]
        ratio = th.exp(log_ratio)
        clipped = th.clamp(ratio, 1 - clip_range, 1 + clip_range)
        policy_loss = -th.min(advantages * ratio, advantages * clipped).mean()
        entropy_loss = -entropy.mean() if entropy is not None else log_prob.mean()
        loss = policy_loss + self.ent_coef * entropy_loss
        loss.backward()
        with th.no_grad():
            kl = ((ratio - 1) - log_ratio).mean()
            clip_fraction = ((ratio - 1).abs() > clip_range).float().mean()
        log = {
            "policy_gradient_loss": policy_loss.detach(),
            "entropy_loss": entropy_loss.detach(),
            "approx_kl": kl,
            "clip_fraction": clip_fraction,
        }
        return log, kl

    def _critic_gradients(self, batch: Minibatch, features: th.Tensor) -> th.Tensor:
        """Add the gradients of the value loss, which is returned."""
        policy, data = self.policy, self.rollout_buffer.flat
        if policy.lstm_critic is None:
            latent = policy.critic(features[batch.order])
        else:
            latent = lstm_outputs(policy.lstm_critic, batch, features, self.rollout_buffer.critic_states)
        values = policy.value_net(policy.mlp_extractor.forward_critic(latent)).flatten()
        if self.clip_range_vf is not None:
            limit = self.clip_range_vf(self._current_progress_remaining)
            old = data["values"][batch.order]
            values = old + th.clamp(values - old, -limit, limit)
        value_loss = ((data["returns"][batch.order] - values) ** 2).mean()
        (self.vf_coef * value_loss).backward()
        loss: th.Tensor = value_loss.detach()
        return loss

    def _log_update(self, logs: list[dict[str, th.Tensor]], clip_range: float) -> None:
        means = {name: th.stack([log[name] for log in logs]).mean().item() for name in logs[0]}
        for name, value in means.items():
            self.logger.record(f"train/{name}", value)
        loss = means["policy_gradient_loss"] + self.ent_coef * means["entropy_loss"]
        self.logger.record("train/loss", loss + self.vf_coef * means["value_loss"])
        buffer = self.rollout_buffer
        self.logger.record(
            "train/explained_variance", explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        )
        if hasattr(self.policy, "log_std"):
            self.logger.record("train/std", th.exp(self.policy.log_std).mean().item())
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/clip_range", clip_range)
