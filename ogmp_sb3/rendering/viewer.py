"""The browser viewer: a loop that plays at a chosen speed, and the controls beside the scene."""

from __future__ import annotations

import logging
import shlex
import time
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from queue import SimpleQueue
from typing import Any

import mujoco
import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.viewer_scene import Stage

FRAME_TIME = 1 / 30  # s between two updates of the scene
PLOT_EVERY = 4  # updates of the scene between two of the plots
PLOT_STEPS = 300  # control steps in the plots
PLOT_HEIGHT = 130  # pixels
IN_TEST = "evaluation.randomisation."
PUSHES = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
REWARD_COLOUR, DEVIATION_COLOUR, RHO_COLOUR = "#2a9d5c", "#2878ff", "#dc3228"


class Viewer:
    """Plays in a browser. What visitors ask for is queued, and done between two steps by the thread that plays.

    :param load: makes the player of a task with overrides (``["rho=0.3"]``)
    :param host: address to listen on
    :param port: the next free one is taken if it is in use
    :param overrides: the first ones
    :param seed: first value of the control that a reset reads
    """

    def __init__(
        self, load: Callable[[list[str]], Player], host: str, port: int, overrides: Iterable[str] = (), seed: int = 0
    ) -> None:
        import viser

        overrides = list(overrides)
        player = load(overrides)
        # Browsers open connections that they do not use; each would be logged as an error.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        self._load, self._seed = load, seed
        self.server = viser.ViserServer(host=host, port=port, label="ogmp-play", verbose=False)
        self._asked: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._open(player, shlex.join(overrides))

    def _open(self, player: Player, overrides: str) -> None:
        """Set the scene and the controls anew.

        :param player: what is played from now on
        :param overrides: of its task, as on a command line
        """
        self.player, frame = player, player.frame
        self.server.scene.reset()
        self.server.gui.reset()
        self.stage = Stage(self.server, player.task, frame)
        self.paused, self.speed = False, 1.0
        self._before = frame  # the frame before the present one, to move smoothly between the two
        self._share = 1.0  # of the control step between them that has passed
        self._history: deque[tuple[float, float]] = deque([(0.0, 0.0)], maxlen=PLOT_STEPS)
        self._updates, self._last_end = 0, ""
        self._add_controls(overrides)
        self.show()

    def run(self) -> None:
        """Play until interrupted."""
        last = time.monotonic()
        while True:
            now = time.monotonic()
            self.advance(now - last)
            last = now
            time.sleep(max(0.0, FRAME_TIME - (time.monotonic() - now)))

    def advance(self, seconds: float) -> None:
        """Do what was asked, play on for some time, and bring the page up to date.

        :param seconds: by the clock on the wall
        """
        while not self._asked.empty():
            self._try(self._asked.get())
        if not self.paused:
            # A machine that is too slow plays slower, rather than ever further behind.
            self._share += min(seconds, 3 * FRAME_TIME) * self.speed / self.player.task.control_dt
            while self._share > 1.0:
                self.step()
                self._share -= 1.0
        self.show()

    def step(self) -> None:
        """One control step."""
        self._before = self.player.frame
        self._try(self.player.step)
        frame = self.player.frame
        self._history.append((frame.reward, frame.deviation))
        if frame.ended:
            self._last_end = f"{frame.ended} at {frame.time:.1f} s, {frame.base[0]:.1f} m"

    def _try(self, action: Callable[[], object]) -> None:
        """Do something; if a command makes it impossible, say so on the page and begin anew without commands."""
        try:
            action()
        except ValueError as error:
            self._last_end = str(error)
            self.player.env.guide.forget_commands(0)
            self.player.reset()

    def show(self) -> None:
        """Bring the page up to date."""
        frame = self.player.frame
        before = self._before if self._before.time < frame.time else frame
        robot, ghost = self._between(before.robot, frame.robot), self._between(before.ghost, frame.ghost)
        self.stage.show(frame, robot, ghost)
        self._updates += 1
        if self._updates % PLOT_EVERY == 1:
            self._status.content = self._described(frame)
            if self.player.policy is not None:
                self._show_plots()

    def _between(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The generalised position between two frames; empty if they have none."""
        model, result = self.stage.robot.model, start.copy()
        if len(start):
            difference = np.zeros(model.nv)
            mujoco.mj_differentiatePos(model, difference, 1.0, start, end)
            mujoco.mj_integratePos(model, result, difference, self._share)
        return result

    def _described(self, frame: Frame) -> str:
        mode, _, parameters = frame.mode.partition(" ")
        lines = [
            f"**{mode}** {parameters}",
            f"{frame.time:.1f} s, {frame.base[0]:.1f} m, {frame.speed:.2f} m/s",
            f"Last episode: {self._last_end or 'none'}",
        ]
        if self.player.policy is not None:
            lines.insert(2, f"reward {frame.reward:.2f}, deviation {frame.deviation:.2f}")
        return "  \n".join(lines)

    # ------------------------------------------------------------------ controls

    def _add_controls(self, overrides: str) -> None:
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._status = gui.add_markdown("")
        if self.player.policy is not None:
            self._add_plots()
        with gui.add_folder("Play"):
            self._set_by(gui.add_checkbox("Pause", False), self, "paused")
            buttons = gui.add_button_group("", ("Step", "Reset"))
            self._set_by(gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0), self, "speed")
            seed_number = gui.add_number("Seed", self._seed, min=0, step=1, hint="taken by a reset")
        actions = {"Step": self._single_step, "Reset": lambda: self.player.reset(int(seed_number.value))}
        buttons.on_click(lambda event: self._asked.put(actions[event.target.value]))
        self._add_commands()
        self._add_overrides(overrides)
        if self.player.policy is not None and self.player.task.randomised:
            self._add_disturbances(overrides)
        if self.player.policy is not None:
            with gui.add_folder("Push"):
                strength = gui.add_slider("Velocity", 0.1, 2.0, 0.1, 0.5, hint="m/s")
                pushes = gui.add_button_group("", tuple(PUSHES))
            pushes.on_click(lambda event: self._asked.put(partial(self._push, event.target.value, strength.value)))
        with gui.add_folder("Show", expand_by_default=False):
            self._set_by(gui.add_checkbox("Follow", True), self.stage, "follow")
            self._set_by(gui.add_checkbox("Ghost", True), self.stage.ghost.node, "visible")
            self._set_by(gui.add_checkbox("Plan", True), self.stage.trail, "visible")
            if self.stage.bound is not None:
                self._set_by(gui.add_checkbox("Bound", True), self.stage.bound, "visible")

    def _add_commands(self) -> None:
        """A mode to choose, its parameters, and a button that has the robot go on with it."""
        gui, modes = self.server.gui, self.player.commands
        inputs: dict[str, dict[str, Any]] = {}
        with gui.add_folder("Command"):
            choice = gui.add_dropdown("Mode", tuple(modes))
            for mode, ranges in modes.items():
                inputs[mode] = {key: _add_parameter(gui, key, range_) for key, range_ in ranges.items()}
            hint = "begin anew with this mode" if self.player.env.guide.timed else "after what lies ahead already"
            button = gui.add_button("Next", hint=hint)

        def show_inputs(_: Any = None) -> None:
            for mode, fields in inputs.items():
                for field in fields.values():
                    field.visible = mode == choice.value

        def command(_: Any) -> None:
            values = {key: field.value for key, field in inputs[choice.value].items()}
            self._asked.put(partial(self.player.command, choice.value, **values))

        show_inputs()
        choice.on_update(show_inputs)
        button.on_click(command)

    def _add_overrides(self, overrides: str) -> None:
        """A field of overrides of the task, and a button to begin anew with them."""
        gui = self.server.gui
        with gui.add_folder("Task", expand_by_default=False):
            field = gui.add_text("Overrides", overrides, hint="e.g. rho=0.3 modes.jump.h=[0.35,0.4]")
            button = gui.add_button("Apply", hint="begin anew with them")
            self._mistake = gui.add_markdown("", visible=False)

        button.on_click(lambda _: self._asked.put(lambda: self._begin_with(field.value)))

    def _begin_with(self, overrides: str) -> None:
        """Begin anew with overrides of the task, or say what is wrong with them."""
        try:
            self._open(self._load(shlex.split(overrides)), overrides)
        except (ValueError, KeyError, TypeError) as error:
            self._mistake.content, self._mistake.visible = str(error.args[0]), True

    def _add_disturbances(self, overrides: str) -> None:
        """A slider for each parameter of the disturbances of the training, and a button to begin anew with them."""
        gui, now = self.server.gui, self.player.task.evaluation.randomised
        sliders: dict[str, Any] = {}
        wanted = {f"{term}.{key}": r.low for term, ranges in now.items() for key, r in ranges.items() if not r.words}
        with gui.add_folder("Disturbances", expand_by_default=False):
            choice = gui.add_dropdown("Disturbance", tuple(self.player.task.randomised))
            for term, ranges in self.player.task.randomised.items():
                for key, range_ in ranges.items():
                    name = f"{term}.{key}"
                    sliders[name] = _add_size(gui, term, key, range_, wanted.get(name))
                    sliders[name].on_update(lambda event, name=name: wanted.update({name: event.target.value}))
            button = gui.add_button("Disturb", hint="begin anew with all of them")

        def show_sliders(_: Any = None) -> None:
            for name, slider in sliders.items():
                slider.visible = name.partition(".")[0] == choice.value

        def apply() -> None:
            others = [key for key in shlex.split(overrides) if not key.startswith(IN_TEST)]
            self._begin_with(shlex.join([*others, *(f"{IN_TEST}{name}={size:g}" for name, size in wanted.items())]))

        show_sliders()
        choice.on_update(show_sliders)
        button.on_click(lambda _: self._asked.put(apply))

    def _set_by(self, control: Any, target: Any, attribute: str) -> None:
        """Have a control set an attribute."""
        control.on_update(lambda event: self._asked.put(partial(setattr, target, attribute, event.target.value)))

    def _single_step(self) -> None:
        self.step()
        self._share = 1.0

    def _push(self, direction: str, speed: float) -> None:
        x, y = PUSHES[direction]
        self.player.push((speed * x, speed * y))

    # ------------------------------------------------------------------ plots

    def _add_plots(self) -> None:
        from viser import uplot

        duration, rho = PLOT_STEPS * self.player.task.control_dt, self.player.task.rho
        self._seconds = np.linspace(-duration, 0.0, PLOT_STEPS)
        deviation = [uplot.Series(label="deviation", stroke=DEVIATION_COLOUR, width=2)]
        if rho is not None:
            deviation.append(uplot.Series(label="rho", stroke=RHO_COLOUR, width=2, dash=(6, 4)))
        reward = [uplot.Series(label="reward", stroke=REWARD_COLOUR, width=2)]
        scales = {"x": uplot.Scale(time=False, range=(-duration, 0.0))}
        bound = "" if rho is None else f" (rho {rho:g}, dashed)"
        self._plots = [
            self.server.gui.add_uplot(
                (self._seconds[-1:], *[np.zeros(1)] * len(series)),
                (uplot.Series(label="s"), *series),
                title=title,
                scales=scales,
                legend=uplot.Legend(show=False),
                height=PLOT_HEIGHT,
            )
            for title, series in ((f"deviation{bound}", deviation), ("reward", reward))
        ]

    def _show_plots(self) -> None:
        reward, deviation = np.array(self._history).T
        seconds, rho = self._seconds[-len(reward) :], self.player.task.rho
        bound = [] if rho is None else [np.full(len(reward), rho)]
        self._plots[0].data = (seconds, deviation, *bound)
        self._plots[1].data = (seconds, reward)


def _add_size(gui: Any, term: str, key: str, range_: Range, now: float | None) -> Any:
    """A slider of a disturbance's parameter, from where nothing is disturbed to half beyond its range.

    :param now: where it is; None: at no disturbance, or in the middle where that is the robot's own
    """
    default = registry.randomisations.parameters(term)[key].default
    none = float(default) if isinstance(default, int | float) else 0.5 * (range_.low + range_.high)
    least, most = registry.randomisations.limits(term).get(key, (-np.inf, np.inf))
    low, high = min(none, range_.low), max(none, range_.high)
    margin = 0.5 * (high - low) or 1.0
    low, high = max(low - margin if range_.low < none else low, least), min(high + margin, most)
    start = min(max(none if now is None else now, low), high)
    marks = tuple((end, f"{end:g}") for end in sorted({range_.low, range_.high}))
    return gui.add_slider(key, low, high, (high - low) / 100, start, marks=marks)


def _add_parameter(gui: Any, key: str, range_: Range) -> Any:
    """A control of one parameter of a mode; the ends of its trained range are marked."""
    if range_.words:
        return gui.add_dropdown(key, range_.words)
    low, high = range_.beyond()
    low, high, middle = (round(value, 2) for value in (min(low, range_.low), high, 0.5 * (range_.low + range_.high)))
    marks = tuple((round(end, 2), f"{end:.2f}") for end in sorted({range_.low, range_.high}))
    return gui.add_slider(key, low, high, 0.01, middle, marks=marks)
