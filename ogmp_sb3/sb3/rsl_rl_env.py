"""Many environments of a task as one ``VecEnv`` of rsl_rl, the learner of Isaac Lab and mjlab."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import torch as th

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.sb3.gym_env import loaded_task
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

UNLOGGED = ("r", "l", "t")  # of an episode's summary: return and length, which rsl_rl counts itself, and the time


def check_installed() -> None:
    """:raises ValueError: naming the extra, if rsl_rl is missing or too old"""
    if any(importlib.util.find_spec(name) is None for name in ("rsl_rl", "tensordict")):
        raise ValueError("the package 'rsl_rl' is missing: pip install \"ogmp_sb3[rsl-rl]\".")
    if importlib.util.find_spec("rsl_rl.models") is None:
        raise ValueError('rsl_rl must be of version 5 or later: pip install --upgrade "ogmp_sb3[rsl-rl]".')


class RslRlVecEnv:
    """Many environments of a task as one ``VecEnv`` of rsl_rl; episodes begin anew in the step that ends them.

    The group ``policy`` is the observation. A task with ``critic_observations`` has a group ``critic`` too: the
    observation with these behind it, so that ``obs_groups={"actor": ["policy"], "critic": ["critic"]}`` gives the
    critic both. ``extras`` holds ``time_outs``, and where episodes ended ``log``, the means of what
    :class:`~ogmp_sb3.sb3.vec_env.OgmpVecEnv` says of each in ``episode``. Tensors are on the CPU, where the physics is;
    rsl_rl's runner moves them to the device of the networks.

    :param task: a task, the name of a shipped one or of one in a plug-in, or the path of a YAML file
    :param num_envs: number of environments
    :param seed: environment i is seeded with ``seed + i``
    :param threads: physics threads, 0 for one per CPU
    :param overrides: replace values of the task, e.g. ``rho=0.3``
    :raises ValueError: if rsl_rl is missing or too old
    """

    def __init__(
        self, task: TaskConfig | str | Path, num_envs: int = 64, seed: int = 0, threads: int = 0, **overrides: Any
    ) -> None:
        check_installed()
        from rsl_rl.env import VecEnv

        VecEnv.register(type(self))  # as if it were a subclass
        self.env = OgmpVecEnv(loaded_task(task, overrides), num_envs, seed, threads)
        batch = self.env.batch
        self.num_envs, self.num_actions = num_envs, batch.action_size
        self.max_episode_length = batch.task.episode_steps
        self.device = "cpu"
        self.cfg = {"task": batch.task.name, "num_envs": num_envs, "seed": seed, **overrides}
        self._observation = self.env.reset()

    @property
    def episode_length_buf(self) -> th.Tensor:
        """Control steps of the episodes so far, shape (num_envs,), int. To set it moves the time limit."""
        return th.as_tensor(self.env.batch.step_count).clone()

    @episode_length_buf.setter
    def episode_length_buf(self, steps: th.Tensor) -> None:
        self.env.batch.step_count[:] = steps.cpu().numpy()

    def get_observations(self) -> Any:
        """The present observations, a ``TensorDict`` of groups of shape (num_envs, size), float32."""
        from tensordict import TensorDict

        groups = {"policy": self._observation}
        critic = self.env.critic_observation
        if critic.shape[1]:
            groups["critic"] = np.concatenate([self._observation, critic], axis=1)
        return TensorDict({name: th.tensor(values) for name, values in groups.items()}, batch_size=[self.num_envs])

    def step(self, actions: th.Tensor) -> tuple[Any, th.Tensor, th.Tensor, dict[str, Any]]:
        """Advance one control step.

        :param actions: shape (num_envs, joints), clipped to [-1, 1]
        :return: observations as above; rewards and ends of episodes, shape (num_envs,); ``extras``
        :raises ValueError: for actions of another shape
        """
        self.env.step_async(actions.detach().cpu().numpy())
        self._observation, rewards, dones, infos = self.env.step_wait()
        time_outs = np.array([info["TimeLimit.truncated"] for info in infos])
        extras: dict[str, Any] = {"time_outs": th.as_tensor(time_outs)}
        ended = [info["episode"] for info in infos if "episode" in info]
        if ended:
            names = (name for name in ended[0] if name not in UNLOGGED)
            extras["log"] = {name: float(np.mean([summary[name] for summary in ended])) for name in names}
        return self.get_observations(), th.as_tensor(rewards), th.as_tensor(dones).long(), extras

    def close(self) -> None:
        """Stop the process that draws pictures, if there is one."""
        self.env.close()
