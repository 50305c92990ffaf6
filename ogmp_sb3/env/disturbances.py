"""Domain randomisation at work: what was drawn for every episode of every environment, and what it does to them.

What can be drawn are the registered terms of :mod:`ogmp_sb3.env.randomisation`; what they give is kept here as arrays,
one row for each environment. :class:`~ogmp_sb3.env.simulation.Simulation` changes models and lets targets and kicks
arrive; :class:`~ogmp_sb3.env.batch_env.BatchEnv` passes actions and observations through.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ogmp_sb3.config.ranges import ModeRanges, Range
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.episode_disturbance import LONGEST_DELAY, OF_OBSERVATIONS, Subject, drawn
from ogmp_sb3.env.events import Events, no_events
from ogmp_sb3.env.observations import Part
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.guidance.sampling import draw_between

NO_KICKS = no_events(2)
NEVER = -1.0  # the physics step in which a target arrives that was never sent
OF_AN_EPISODE = ("action_delay", "action_jitter", "sensor_delay", "sensor_jitter", "step_jitter", "push_speed",
                 "push_every", "force", "ground", "gains", "target_offset")  # fmt: skip


class Disturbances:
    """What was drawn for every environment.

    The generators are apart from those of the tracks, so that tracks are the same with and without disturbances.
    Nothing is drawn before :meth:`know` has said what there is to disturb.

    :param tasks: a task for each environment, whose ``randomisation`` it has
    :param sim: the simulations
    """

    def __init__(self, tasks: Sequence[TaskConfig], sim: Simulation) -> None:
        self._tasks, self._sim = tasks, sim
        self._physics_dt, self._substeps = tasks[0].physics_dt, tasks[0].substeps
        self._rng = [np.random.default_rng() for _ in tasks]
        self._places: dict[str, slice] = {}
        self._parts: dict[str, Part] = {}
        self._typical: dict[str, np.ndarray] = {}
        self._arrays: dict[str, np.ndarray] = {}  # empty if nothing is ever disturbed
        self._fields: dict[str, np.ndarray] = {}  # of the models that are varied
        if any(task.randomised for task in tasks):
            joints, boxes = len(tasks[0].robot_config.joints), tasks[0].track.boxes
            self._depth = int(self._physics_steps(LONGEST_DELAY)) // self._substeps + 2
            shapes: dict[str, tuple[int, ...]] = dict.fromkeys((*OF_AN_EPISODE, "next_push"), ())
            shapes |= {"force": (3,), "ground": (boxes,), "gains": (joints,), "target_offset": (joints,)}
            # What was sent, newest first, and in how many physics steps it arrives.
            shapes |= {"targets": (self._depth, joints), "arrive": (self._depth,)}
            self._arrays = {name: np.zeros((len(tasks), *shape)) for name, shape in shapes.items()}
            self._arrays["arrive"][:] = NEVER
            self._arrays["gains"][:] = 1.0

    def know(self, parts: Sequence[Part], scale: np.ndarray) -> None:
        """Say what the policy observes, and try what the terms give at both ends of all ranges.

        :param parts: what is observed, in order
        :param scale: typical sizes of it, shape (size,)
        :raises FunctionFailed: if a term's function raises an exception
        :raises TypeError: if a term answers with something of the wrong type
        :raises ValueError: if what it gives does not fit the robot or the task
        """
        if not self._arrays:
            return
        ends = np.cumsum([part.size for part in parts], dtype=int)
        self._places = {part.name: slice(end - part.size, end) for part, end in zip(parts, ends, strict=True)}
        self._parts = {part.name: part for part in parts}
        self._typical = {name: scale[place] for name, place in self._places.items()}
        for name in (*OF_OBSERVATIONS, "last"):
            self._arrays[name] = np.zeros((len(self._tasks), len(scale)))
        self._arrays["history"] = np.zeros((len(self._tasks), self._depth, len(scale)))  # newest first
        self._sensed = np.repeat([part.sensed for part in parts], [part.size for part in parts])
        for task in {id(task): task for task in self._tasks}.values():
            subject = self._subject(np.random.default_rng(0))
            least = drawn(task, subject, lambda _, __, full: full.corners()[0], checked=False)
            most = drawn(task, subject, lambda _, __, full: full.corners()[-1], checked=False)
            self._make_room([*least.model, *most.model], subject)

    # ------------------------------------------------------------------ an episode's draw

    def seed_row(self, row: int, rng: np.random.Generator) -> None:
        """Give an environment a generator spawned from its own one."""
        self._rng[row] = rng.spawn(1)[0]

    def begin(self, rows: np.ndarray, level: np.ndarray) -> None:
        """Draw anew for the next episodes of some environments, and change their robots.

        :param rows: environments, shape (n,), int
        :param level: curriculum levels of all, shape (num_envs,)
        """
        if not self._places:
            return
        for row in rows:
            self._draw(int(row), float(level[row]))
        self._arrays["arrive"][rows] = NEVER
        self.vary(rows)

    def vary(self, rows: np.ndarray) -> None:
        """Make the robots of some environments what was drawn for them."""
        if self._places:
            self._sim.vary(rows, self.varied(rows))

    def varied(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """What :meth:`~ogmp_sb3.env.simulation.Simulation.vary` is to change in some environments, shapes (n, ...)."""
        if not self._places:
            return {}
        own = {name: self._arrays[name][rows] for name in ("gains", "force", "ground")}
        return own | {name: values[rows] for name, values in self._fields.items()}

    def _draw(self, row: int, level: float) -> None:
        """An episode's disturbance of an environment."""
        task, arrays, rng = self._tasks[row], self._arrays, self._rng[row]
        easy: ModeRanges = task.curriculum.randomisation if task.curriculum else {}

        def value(term: str, key: str, full: Range) -> float | str:
            return draw_between(easy.get(term, {}).get(key, full), full, level, rng)

        subject = self._subject(rng)
        total = drawn(task, subject, value, checked=True)
        for name in OF_AN_EPISODE:
            arrays[name][row] = getattr(total, name)
        for name in OF_OBSERVATIONS:
            arrays[name][row] = 0.0
            for part, size in getattr(total, name).items():
                if part in self._places:
                    arrays[name][row, self._places[part]] = size
        # Whole control steps: what is within one, the sensors are read earlier for.
        steps = np.rint(arrays["age"][row] / task.control_dt)
        steps[self._sensed] += self._physics_steps(total.sensor_delay) // self._substeps
        arrays["age"][row] = steps
        self._make_room(total.model, subject)
        for name, values in self._fields.items():
            values[row] = total.model.get(name, subject.field(name))
        if total.push_every > 0.0:
            arrays["next_push"][row] = rng.integers(max(self._physics_steps(total.push_every), 1))

    def _make_room(self, names: Iterable[str], subject: Subject) -> None:
        """Have fields of the models that terms vary, as the robot has them where none does."""
        for name in names:
            if name not in self._fields:
                self._fields[name] = np.repeat(subject.field(name)[None], len(self._tasks), axis=0)

    def _subject(self, rng: np.random.Generator) -> Subject:
        return Subject(
            robot=self._tasks[0].robot_config,
            model=self._sim.model,
            servos=self._sim.servos,
            boxes=self._tasks[0].track.boxes,
            parts=self._parts,
            typical=self._typical,
            varied={},
            rng=rng,
        )

    # ------------------------------------------------------------------ a control step

    def arrivals(self, targets: np.ndarray, rows: np.ndarray | None, lengths: np.ndarray | None) -> Events:
        """The joint targets that reach the servos in this control step, rad; they keep those that they have until then.

        :param targets: what is sent at its start, shape (num_envs, joints), rad
        :param rows: environments that are stepped, or None for all
        :param lengths: of :meth:`lengths`
        """
        every = np.arange(len(targets))
        if not self._arrays:
            return Events(np.zeros_like(every), every, targets)
        arrays, rows = self._arrays, every if rows is None else rows
        steps = np.full(len(rows), self._substeps) if lengths is None else lengths[rows]
        sent, arrive = arrays["targets"], arrays["arrive"]
        sent[rows, 1:], arrive[rows, 1:] = sent[rows, :-1], arrive[rows, :-1]
        sent[rows, 0] = targets[rows] + arrays["target_offset"][rows]
        arrive[rows, 0] = self._physics_steps(self._with_jitter("action", rows))
        which, ago = np.nonzero((arrive[rows] >= 0) & (arrive[rows] < steps[:, None]))
        order = np.argsort(-ago, kind="stable")  # where two arrive together, the later one is in force
        chosen, ago = rows[which[order]], ago[order]
        events = Events(arrive[chosen, ago].astype(int), chosen, sent[chosen, ago])
        arrive[rows] -= steps[:, None]
        return events

    def _with_jitter(self, what: str, rows: np.ndarray) -> np.ndarray:
        """Delays of actions or sensors, drawn anew where they vary, shape (n,), s."""
        delays: np.ndarray = self._arrays[f"{what}_delay"][rows]
        jitter = self._arrays[f"{what}_jitter"][rows]
        for i in np.flatnonzero(jitter):
            delays[i] += self._rng[rows[i]].uniform(0.0, jitter[i])
        return delays

    def kicks(self, rows: np.ndarray | None, lengths: np.ndarray | None) -> Events:
        """Pushes of this control step: changes of horizontal velocities, m/s.

        :param rows: environments that are stepped, or None for all
        :param lengths: of :meth:`lengths`
        """
        if not self._arrays or not self._arrays["push_speed"].any():
            return NO_KICKS
        arrays, rows = self._arrays, np.arange(len(self._tasks)) if rows is None else rows
        rows = rows[(arrays["push_speed"][rows] > 0.0) & (arrays["push_every"][rows] > 0.0)]
        steps = np.full(len(rows), self._substeps) if lengths is None else lengths[rows]
        every = np.maximum(self._physics_steps(arrays["push_every"][rows]), 1)
        next_push = arrays["next_push"]  # physics steps from now
        kicks = []
        for row, length, apart in zip(rows, steps, every, strict=True):
            while next_push[row] < length:
                kicks.append((int(next_push[row]), row, self._kick(row)))
                next_push[row] += apart
        next_push[rows] -= steps
        if not kicks:
            return NO_KICKS
        return Events(*map(np.array, zip(*kicks, strict=True)))

    def _kick(self, row: int) -> tuple[float, float]:
        """A change of velocity in a random direction, m/s."""
        angle, speed = self._rng[row].uniform(0.0, 2.0 * np.pi), float(self._arrays["push_speed"][row])
        return speed * np.cos(angle), speed * np.sin(angle)

    def lengths(self, rows: np.ndarray | None) -> np.ndarray | None:
        """Physics steps of this control step, shape (num_envs,), int; None: as many as the task says.

        :param rows: environments that are stepped, or None for all
        """
        if not self._arrays or not self._arrays["step_jitter"].any():
            return None
        lengths = np.full(len(self._tasks), self._substeps)
        for row in np.arange(len(self._tasks)) if rows is None else rows:
            most = int(self._physics_steps(self._arrays["step_jitter"][row]))
            if most:
                lengths[row] = max(self._substeps + int(self._rng[row].integers(-most, most + 1)), 1)
        return lengths

    # ------------------------------------------------------------------ what is observed

    def sensed_at(self, rows: np.ndarray | None, lengths: np.ndarray | None) -> np.ndarray | None:
        """Behind which physics step of this control step sensors are read, shape (num_envs,), int; None: at its end.

        :param rows: environments that are stepped, or None for all
        :param lengths: of :meth:`lengths`
        """
        if not self._arrays or not (self._arrays["sensor_delay"].any() or self._arrays["sensor_jitter"].any()):
            return None
        at: np.ndarray = np.full(len(self._tasks), self._substeps) if lengths is None else lengths.copy()
        rows = np.arange(len(self._tasks)) if rows is None else rows
        whole = self._physics_steps(self._arrays["sensor_delay"][rows]) // self._substeps * self._substeps
        at[rows] -= self._physics_steps(self._with_jitter("sensor", rows)) - whole
        at[at < 0] = 0
        return at

    def measured(self, values: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
        """What the policy observes, as sensors give it; to be asked once for every observation.

        :param values: as it is, shape (n, size)
        :param rows: the environments, shape (n,), int, or None for all
        """
        arrays = self._arrays
        if not self._places:
            return values
        rows = np.arange(len(values)) if rows is None else rows
        measured: np.ndarray = self._as_old_as_it_is(values, rows) + arrays["bias"][rows]
        # One generator for each environment, so that its noise does not depend on how many others there are.
        for i in np.flatnonzero(arrays["noise"][rows].any(axis=1)):
            measured[i] += arrays["noise"][rows[i]] * self._rng[rows[i]].standard_normal(values.shape[1])
        for i in np.flatnonzero(arrays["dropout"][rows].any(axis=1)):
            kept = self._rng[rows[i]].random(values.shape[1]) < arrays["dropout"][rows[i]]
            measured[i, kept] = arrays["last"][rows[i], kept]
        arrays["last"][rows] = measured
        return measured

    def _as_old_as_it_is(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Values of the control steps that they are old, shape (n, size)."""
        if not self._arrays["age"].any():
            return values
        age, history = self._arrays["age"][rows].astype(int), self._arrays["history"]
        history[rows, 1:] = history[rows, :-1]
        history[rows, 0] = values
        old: np.ndarray = history[rows[:, None], age, np.arange(values.shape[1])]
        return old

    def first_measured(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """As :meth:`measured`, of environments whose episodes begin: before it everything was as it is."""
        if self._places:
            self._arrays["last"][rows] = values
            self._arrays["history"][rows] = values[:, None]
        return self.measured(values, rows)

    # ------------------------------------------------------------------ state

    def under_way(self) -> list[np.ndarray]:
        """The arrays of the targets that were sent, when they arrive, and how late others will."""
        return [self._arrays[name] for name in ("arrive", "targets", "action_delay") if name in self._arrays]

    def arrays(self) -> dict[str, np.ndarray]:
        """All that was drawn; empty if no disturbance is in use."""
        return {**self._arrays, **self._fields}

    def plain(self) -> dict[str, Any]:
        """The generators, if any disturbance is in use."""
        return {"disturbances": [rng.bit_generator.state for rng in self._rng]} if self._arrays else {}

    def set_plain(self, plain: Mapping[str, Any]) -> None:
        """Put back what :meth:`plain` gave."""
        for rng, state in zip(self._rng if self._arrays else (), plain.get("disturbances", ()), strict=True):
            rng.bit_generator.state = state

    def _physics_steps(self, seconds: Any) -> Any:
        """Times as physics steps, int."""
        return np.rint(np.asarray(seconds) / self._physics_dt).astype(int)
