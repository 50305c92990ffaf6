"""BatchEnv: many environments of one task, stepped together. The one stateful class; adapters sit on top."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env import snapshots
from ogmp_sb3.env.disturbances import Disturbances
from ogmp_sb3.env.endings import RUNNING, TIME_LIMIT, ending
from ogmp_sb3.env.initial import InitialStates
from ogmp_sb3.env.observer import Observer
from ogmp_sb3.env.restarts import Restarts
from ogmp_sb3.env.row_tasks import common_task
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.env.streams import Stream, generator
from ogmp_sb3.env.terms import bind
from ogmp_sb3.env.view import EnvView, srb_state
from ogmp_sb3.guidance.guide import Guide
from ogmp_sb3.guidance.sampling import ModeCall, PlainModes, mode_calls, plain_modes
from ogmp_sb3.guidance.srb import VEL, deviation
from ogmp_sb3.guidance.terrain import height_at

STATE_ARRAYS = ("step_count", "level", "_ended", "restarted", "_action")
MAX_ENVS = 100_000  # more is a slip of the pen


@dataclass(frozen=True)
class StepResult:
    """What one control step of all environments gives. Nothing is reset."""

    observation: np.ndarray
    """shape (num_envs, size), float32"""
    reward: np.ndarray
    """shape (num_envs,)"""
    terminated: np.ndarray
    """the episode ended by a rule of the task, shape (num_envs,), bool"""
    truncated: np.ndarray
    """the episode reached its time limit, shape (num_envs,), bool"""
    termination: np.ndarray
    """which rule ended the episode, shape (num_envs,), text; empty while it runs"""
    view: EnvView
    """the step itself"""
    reward_terms: dict[str, np.ndarray]
    """each reward term, shape (num_envs,)"""


class BatchEnv:
    """``num_envs`` environments of a task.

    Row ``i`` draws all its randomness from ``seed + i``, so four rows equal four environments of one. The same seed
    gives other tracks in another stream (:mod:`ogmp_sb3.env.streams`).

    :param task: the task
    :param num_envs: number of environments
    :param seed: seed of row 0
    :param threads: physics threads, 0 for one per CPU
    :param stream: what the episodes are for: ``"training"``, ``"test"`` or ``"selection"``
    :param row_tasks: a task for each row, by which its modes and disturbances are drawn; they differ in nothing else
        (:func:`~ogmp_sb3.env.row_tasks.common_task`). Empty: ``task`` for all
    :raises ValueError: if the task cannot be built
    """

    def __init__(
        self,
        task: TaskConfig,
        num_envs: int = 1,
        seed: int = 0,
        threads: int = 0,
        stream: Stream = "training",
        row_tasks: Sequence[TaskConfig] = (),
    ) -> None:
        if not 1 <= num_envs <= MAX_ENVS:
            raise ValueError(f"'num_envs' must be at least 1 and at most {MAX_ENVS:,}, found {num_envs}.")
        if row_tasks:
            if len(row_tasks) != num_envs:
                raise ValueError(f"'row_tasks' must be {num_envs} tasks, one for each row, found {len(row_tasks)}.")
            task = common_task([task, *row_tasks])
        self.task, self.num_envs, self.stream, self.row_tasks = task, num_envs, stream, row_tasks
        self.sim = Simulation(task.robot_config, num_envs, task.physics_dt, task.track.boxes, threads)
        self.guide = Guide(task, num_envs, row_tasks)
        self._rewards = bind(registry.rewards, task.rewards)
        self._terminations = bind(registry.terminations, task.terminations)
        self._weights = np.array(task.bound_weights)
        self._nominal = np.array(task.robot_config.nominal_joints)
        self.disturbances = Disturbances(row_tasks or [task] * num_envs, self.sim)
        self.observer = Observer(task)
        self.initial = InitialStates(task.initial, task.robot_config, self.sim)

        self.step_count = np.zeros(num_envs, dtype=int)
        self._action = np.zeros((num_envs, self.action_size))  # the last one, clipped
        self._every = np.arange(num_envs)
        self._first_level = 1.0 if task.curriculum is None else 0.0
        self.level = np.full(num_envs, self._first_level)
        self._rng = [np.random.default_rng() for _ in range(num_envs)]
        self._ended = np.zeros(num_envs, dtype=bool)
        self.restarted = np.zeros(num_envs, dtype=bool)  # the episode began before an earlier fall
        self.restarts = Restarts(task.restarts, num_envs, snapshots.pack(self._moment_arrays(), np.arange(1)).shape[1])
        self.seed(seed)
        self.reset()
        view = self.view()
        self.observation_scale = self.observer.scale(view)
        self.disturbances.know(self.observer.parts(view), self.observation_scale)
        self.seed(seed)

    # ------------------------------------------------------------------ interface

    @property
    def observation_size(self) -> int:
        """Length of one observation."""
        return len(self.observation_scale)

    @property
    def terrain(self) -> np.ndarray:
        """Terrain boxes, shape (num_envs, boxes, 5)."""
        return self.guide.terrain

    @property
    def modes(self) -> list[list[ModeCall]]:
        """The modes of each environment's variant so far."""
        return self.guide.modes

    @property
    def action_size(self) -> int:
        """Length of one action."""
        return len(self._nominal)

    def seed(self, seed: int) -> None:
        """Give row ``i`` the generator of ``seed + i``, and start its curriculum anew without commands."""
        for row in range(self.num_envs):
            self.seed_row(row, seed + row)

    def seed_row(self, row: int, seed: int) -> None:
        """Give one row a generator of its own, and start its curriculum anew without commands."""
        self._rng[row] = generator(seed, self.stream)
        self.disturbances.seed_row(row, self._rng[row])
        self.restarts.seed_row(row, self._rng[row])
        self.initial.seed_row(row, self._rng[row])
        self.guide.forget_commands(row)
        self._ended[row] = False
        self.level[row] = self._first_level

    def command(self, row: int, mode: str, **parameters: float | str) -> None:
        """Have an environment go on with a mode behind the track that is laid already, before drawn ones.

        Several commands follow each other. The oracle plans them from wherever the robot is.

        :param row: the environment
        :param mode: name of one of the task's modes
        :param parameters: its parameters; those left out are drawn from the task's ranges
        :raises KeyError: for an unknown mode, parameter or word
        :raises TypeError: for a value of the wrong type
        :raises ValueError: for a value below 0, or a timed mode that lasts too long
        """
        self.guide.command(row, mode, parameters, self._rng[row])

    def reset(self, rows: np.ndarray | None = None) -> np.ndarray:
        """Begin new episodes.

        :param rows: which environments, sorted, shape (n,), int; None for all
        :return: their observations, shape (n, size), float32
        """
        rows = np.arange(self.num_envs) if rows is None else np.asarray(rows)
        self._update_levels(rows)
        self.step_count[rows], self._action[rows] = 0, 0.0
        begun_from = {int(row): moment for row in rows if (moment := self.restarts.take(int(row)))}
        self._begin(np.array([row for row in rows if row not in begun_from], dtype=int))
        if begun_from:
            self._go_back(begun_from)
        self.restarted[rows] = [row in begun_from for row in rows]
        self._ended[rows] = False
        return self.observer.policy(self.view(rows), lambda values: self.disturbances.first_measured(values, rows))

    def _begin(self, rows: np.ndarray) -> None:
        """Put robots down at the start of new variants of the task."""
        if not len(rows):
            return
        start = self.initial.draw(rows)
        ground = np.zeros(len(rows))
        for i, row in enumerate(rows):
            ground[i] = self.guide.begin(row, self._rng[row], float(self.level[row]), float(start.xy[i, 0]))
        self.disturbances.begin(rows, self.level)
        self.sim.set_terrain(rows, self.terrain[rows])
        self.initial.put_down(rows, start, ground, self.terrain[rows])
        self.guide.query(rows, self._states(rows))

    def _go_back(self, moments: dict[int, tuple[np.ndarray, PlainModes]]) -> None:
        """Put environments back to moments that were remembered."""
        rows = np.array(list(moments))
        self.disturbances.begin(rows, self.level)
        self.sim.place(rows, np.zeros((len(rows), 3)), self._nominal)
        snapshots.unpack(self._moment_arrays(), rows, np.stack([vector for vector, _ in moments.values()]))
        for row, (_, modes) in moments.items():
            self.modes[row] = mode_calls(modes)
        self.sim.apply_force(rows)
        self.sim.set_terrain(rows, self.terrain[rows])

    def _moment_arrays(self) -> list[np.ndarray]:
        """What an environment is put back to."""
        return [*self.guide.arrays().values(), *self.disturbances.under_way(), self.sim.mj.state]

    def step(self, actions: np.ndarray, rows: np.ndarray | None = None) -> StepResult:
        """Advance one control step.

        :param actions: shape (num_envs, joints), clipped to [-1, 1]
        :param rows: step the physics of these only (sorted); the results of the others mean nothing
        :raises ValueError: for actions of another shape
        """
        task = self.task
        shape = (self.num_envs, self.action_size)
        if np.shape(actions) != shape:
            raise ValueError(f"actions must be of shape {shape}, found {np.shape(actions)}.")
        self._action[:] = np.clip(actions, -1.0, 1.0)
        self._advance(self._nominal + task.action.scale * self._action, rows)
        self.guide.advance()
        self.step_count += 1

        view = self.view()
        reward_terms = {name: term(view) for name, term in self._rewards.items()}
        reward = np.sum(list(reward_terms.values()), axis=0) if reward_terms else np.zeros(self.num_envs)
        unstable = self.sim.unstable()
        termination = ending(task, self._terminations, view, reward, unstable, self.step_count, self.restarted)
        self._ended = termination != RUNNING
        terminated = (termination != RUNNING) & (termination != TIME_LIMIT)
        if unstable.any():
            reward = np.where(unstable, 0.0, reward)
            reward_terms = {name: np.where(unstable, 0.0, value) for name, value in reward_terms.items()}
            view = replace(view, deviation=np.where(unstable, 0.0, view.deviation))

        x = self.sim.qpos[:, self.sim.base_qpos]
        changed = self.guide.follow(np.flatnonzero(~terminated), x, self._states, self._rng, self.level)
        if len(changed):
            self.sim.set_terrain(changed, self.terrain[changed])
        self._remember(terminated & ~unstable)
        if self.sim.sensed_at is None:
            ahead = replace(view, terrain=self.terrain, **self.guide.knots(self._every, x)._asdict())
        else:
            ahead = self._view(self._every, self.sim.sensed["qpos"], self.sim.sensed["qvel"])
        return StepResult(
            observation=self.observer.policy(ahead, lambda values: self.disturbances.measured(values, None)),
            reward=reward,
            terminated=terminated,
            truncated=termination == TIME_LIMIT,
            termination=termination,
            view=view,
            reward_terms=reward_terms,
        )

    def critic_observation(self, rows: np.ndarray | None = None) -> np.ndarray:
        """What only the critic sees at present of some environments, by default all, shape (n, size), float32.

        In typical sizes of each value; see ``critic_observations`` of the task.
        """
        if not self.observer.critic_sees_more:
            return np.zeros((self.num_envs if rows is None else len(rows), 0), dtype=np.float32)
        return self.observer.critic(self.view(rows))

    def plan(self, row: int) -> np.ndarray:
        """The oracle's present reference of an environment, from the query on, shape (knots + 1, 12)."""
        return self.guide.plan(row)

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The whole state but commands: arrays, and plain data (generators, modes drawn so far)."""
        arrays, plain = (
            snapshots.take(self._own_arrays()),
            {"generators": [rng.bit_generator.state for rng in self._rng]},
        )
        for prefix, part in self._parts().items():
            arrays |= snapshots.take(part.arrays(), prefix)
            plain |= part.plain()
        return arrays, plain

    def set_state(self, arrays: dict[str, np.ndarray], plain: dict[str, Any]) -> None:
        """Go on exactly where :meth:`state` was taken, in an environment of the same task and size, without commands.

        :raises ValueError: if the state is of another task or number of environments
        """
        arrays = {"_action": np.zeros_like(self._action), **arrays}  # older states do not have it
        for prefix, part in self._parts().items():
            snapshots.put_back(part.arrays(), arrays, prefix)
            part.set_plain(plain)
        self.disturbances.vary(self._every)
        self.sim.place(self._every, np.zeros((self.num_envs, 3)), self._nominal)
        self.sim.set_terrain(self._every, self.terrain)
        snapshots.put_back(self._own_arrays(), arrays)
        for rng, state in zip(self._rng, plain["generators"], strict=True):
            rng.bit_generator.state = state

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = self.task, self.num_envs, 0, self.sim.threads, self.stream, self.row_tasks
        return snapshots.restored, (type(self), arguments, self.state())

    def _parts(self) -> dict[str, snapshots.Part]:
        """What has a state of its own, by the prefix of its arrays in a saved state."""
        drawn: dict[str, snapshots.Part] = {"disturbances.": self.disturbances, "initial.": self.initial}
        return {"": self.guide, **drawn, "restarts.": self.restarts}

    def _own_arrays(self) -> dict[str, np.ndarray]:
        return {name: getattr(self, name) for name in STATE_ARRAYS} | {"sim": self.sim.mj.state}

    # ------------------------------------------------------------------ parts of a step

    def view(self, rows: np.ndarray | None = None) -> EnvView:
        """The present state of some environments, by default all."""
        rows = self._every if rows is None else rows
        return self._view(rows, self.sim.qpos[rows], self.sim.qvel[rows])

    def _view(self, rows: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> EnvView:
        """The view of some environments whose robots are in these positions and velocities."""
        sim = self.sim
        p, v = sim.base_qpos, sim.base_qvel
        # np.take keeps rows contiguous, so that sums over a row do not depend on how many rows there are.
        joint_pos, joint_vel = qpos.take(sim.joint_qpos, axis=1), qvel.take(sim.joint_qvel, axis=1)
        position, terrain, knots = qpos[:, p : p + 3], self.terrain[rows], self.guide.knots(rows, qpos[:, p])
        state, linvel_b = srb_state(qpos[:, p : p + 7], qvel[:, v : v + 6])
        return EnvView(
            base_pos_w=position,
            base_quat=qpos[:, p + 3 : p + 7],
            base_linvel_w=state[:, VEL],
            base_linvel_b=linvel_b,
            base_angvel_b=qvel[:, v + 3 : v + 6],
            joint_pos=joint_pos,
            joint_vel=joint_vel,
            down=sim.down[rows],
            action=self._action[rows],
            torque=sim.torque(rows, joint_pos, joint_vel),
            body_contact=sim.body_contact()[rows],
            terrain=terrain,
            ground_height=height_at(terrain, position[:, None, :2])[:, 0],
            state=state,
            deviation=deviation(state, knots.reference, self._weights),
            **knots._asdict(),
        )

    def _states(self, rows: np.ndarray) -> np.ndarray:
        """Single-rigid-body states of some robots, shape (n, 12)."""
        p, v = self.sim.base_qpos, self.sim.base_qvel
        return srb_state(self.sim.qpos[rows, p : p + 7], self.sim.qvel[rows, v : v + 6])[0]

    def _advance(self, targets: np.ndarray, rows: np.ndarray | None) -> None:
        """Move the robots on by one control step.

        :param targets: joint positions, shape (num_envs, joints), rad
        :param rows: these only, or None for all
        """
        lengths = self.disturbances.lengths(rows)
        arrivals = self.disturbances.arrivals(targets, rows, lengths)
        kicks = self.disturbances.kicks(rows, lengths)
        sensed_at = self.disturbances.sensed_at(rows, lengths)
        self.sim.step(rows, self.task.substeps if lengths is None else lengths, arrivals, kicks, sensed_at)

    def _remember(self, fallen: np.ndarray) -> None:
        """Keep the moments that are due, and those before a fall."""
        for row in np.flatnonzero(fallen & ~self.restarted) if self.task.restarts else ():
            self.restarts.fallen(int(row), int(self.step_count[row]), plain_modes(self.modes[row]))
        rows = self.restarts.due(self.step_count)
        if len(rows):
            laid = np.array([len(self.modes[row]) for row in rows])
            self.restarts.remember(rows, self.step_count[rows], snapshots.pack(self._moment_arrays(), rows), laid)

    def _update_levels(self, rows: np.ndarray) -> None:
        curriculum = self.task.curriculum
        if curriculum is not None:
            # An episode that was broken off does not count, nor does one that began before a fall.
            counted = rows[self._ended[rows] & ~self.restarted[rows]]
            lasted = self.step_count[counted] / self.task.episode_steps
            self.level[counted] = curriculum.moved(self.level[counted], lasted)
