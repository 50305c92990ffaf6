"""Play one environment step by step, with commands and pushes: what a viewer shows and a video records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import Actor, AnyPolicy
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.guidance.rotations import quat_rotate_inverse
from ogmp_sb3.guidance.sampling import ModeCall, draw_parameters
from ogmp_sb3.guidance.srb import OMEGA, POS, VEL
from ogmp_sb3.rendering.frame import Frame, frame_of

ENDLESS = 10**9  # control steps


class OracleEnv(BatchEnv):
    """Robots moved along the oracle's reference in their nominal pose, without physics."""

    def _advance(self, targets: np.ndarray, rows: np.ndarray | None) -> None:
        every, knot = np.arange(self.num_envs), self.guide.plans.phase + 1
        state, quat = self.guide.plans.reference[every, knot], self.guide.plans.quat[every, knot]
        p, v = self.sim.base_qpos, self.sim.base_qvel
        self.sim.qpos[:, p : p + 3], self.sim.qpos[:, p + 3 : p + 7] = state[:, POS], quat
        self.sim.qvel[:, v : v + 3] = state[:, VEL]
        self.sim.qvel[:, v + 3 : v + 6] = quat_rotate_inverse(quat, state[:, OMEGA])


def endless(task: TaskConfig) -> TaskConfig:
    """The task as it is played: by its test protocol, but a track goes on for as long as the robot does."""
    played = replace(task.for_evaluation(), track=task.track)
    return played if task.horizon is None else replace(played, episode_steps=ENDLESS)


class Player:
    """One environment and who moves the robot in it: a policy, by its deterministic actions, or else the oracle.

    An episode that has ended begins anew at the next step.

    :param task: the task as in training; its bound is only shown
    :param policy: a model, a policy or a loaded policy; None: the robot follows the oracle's references exactly
    :param seed: of the modes that are drawn, the same as in a test episode of this seed
    :raises ValueError: if the policy does not fit the task
    """

    def __init__(self, task: TaskConfig, policy: AnyPolicy | None, seed: int = 0) -> None:
        self.task, self.policy = task, policy
        self._actor: Actor | None = None
        if policy is None:
            unobserved = replace(
                endless(task), terminations={}, observations={"clock": {}}, critic_observations={}, initial=None
            )
            self.env: BatchEnv = OracleEnv(unobserved, 1, seed, threads=1, stream="test")
        else:
            self.env = BatchEnv(endless(task), 1, seed, threads=1, stream="test")
            self._actor = Actor(policy, 1, self.env.observation_size)
        self.reset()

    @property
    def commands(self) -> dict[str, dict[str, Range]]:
        """The modes that can be commanded, with the ranges of their parameters: those that bring their ground."""
        rng, modes = np.random.default_rng(0), self.task.mode_ranges
        calls = {name: ModeCall(name, draw_parameters(ranges, rng)) for name, ranges in modes.items()}
        return {name: modes[name] for name, call in calls.items() if call.segment().plateaus}

    def reset(self, seed: int | None = None) -> Frame:
        """Begin a new episode.

        :param seed: forget what was commanded; None: go on drawing modes where the last episode stopped
        """
        if seed is not None:
            self.env.seed(seed)
        self._observation = self.env.reset()
        if self._actor is not None:
            self._actor.restart()
        self.frame = self._frame(self.env.view(), None, 0.0, "")
        return self.frame

    def step(self) -> Frame:
        """One control step, or a new episode if the last one has ended."""
        if self.frame.ended:
            return self.reset()
        action = np.zeros((1, self.env.action_size))
        if self._actor is not None:
            action = self._actor.act(self._observation)
        result = self.env.step(action)
        self._observation = result.observation
        frame = self._frame(result.view, self.frame, float(result.reward[0]), str(result.termination[0]))
        terms = {name: float(values[0]) for name, values in result.reward_terms.items()}
        self.frame = replace(frame, reward_terms=terms)
        return self.frame

    def command(self, mode: str, **parameters: float | str) -> None:
        """Have the robot go on with a mode (:meth:`BatchEnv.command`); in a timed task, begin anew with it.

        :raises KeyError: for an unknown mode or parameter
        :raises ValueError: for a timed mode that lasts too long
        """
        self.env.command(0, mode, **parameters)
        if self.env.guide.timed:
            self.reset()

    def push(self, velocity: tuple[float, float]) -> None:
        """Change the velocity of the base at once.

        :param velocity: along x and y of the world, m/s
        """
        v = self.env.sim.base_qvel
        self.env.sim.qvel[0, v : v + 2] += velocity

    def contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the robot touches the ground now, and the forces on it; none where only the oracle plays.

        :return: points, shape (n, 3), m, and forces, shape (n, 3), N
        """
        return (np.zeros((0, 3)), np.zeros((0, 3))) if self.policy is None else self.env.sim.contacts(0)

    def _frame(self, view: EnvView, before: Frame | None, reward: float, ended: str) -> Frame:
        frame = frame_of(self.env, 0, view, before, reward, ended)
        return replace(frame, robot=np.zeros(0)) if self.policy is None else frame
