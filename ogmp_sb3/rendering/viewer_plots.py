"""Plots beside the scene of the viewer: deviation and reward over the last control steps."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.rendering.frame import Frame

if TYPE_CHECKING:
    import viser

STEPS = 300  # control steps in the plots
HEIGHT = 130  # pixels
REWARD_COLOUR, DEVIATION_COLOUR, RHO_COLOUR = "#2a9d5c", "#2878ff", "#dc3228"
Line = tuple[str, str, tuple[int, ...]]  # name, colour, dashes
TERM_COLOURS = ("#e69f00", "#cc79a7", "#56b4e9", "#8c564b", "#6a3d9a", "#17becf")


class Plots:
    """The deviation with its bound, and the reward with its terms.

    :param gui: viser's controls
    :param task: the task as in training
    """

    def __init__(self, gui: viser.GuiApi, task: TaskConfig) -> None:
        from viser import uplot

        self._rho, self._terms = task.rho, [name for name, given in task.rewards.items() if given is not None]
        self._history: deque[list[float]] = deque([[0.0] * (2 + len(self._terms))], maxlen=STEPS)
        duration = STEPS * task.control_dt
        self._seconds = np.linspace(-duration, 0.0, STEPS)
        deviation: list[Line] = [("deviation", DEVIATION_COLOUR, ())]
        if self._rho is not None:
            deviation.append(("rho", RHO_COLOUR, (6, 4)))
        colours = [TERM_COLOURS[i % len(TERM_COLOURS)] for i in range(len(self._terms))]
        reward: list[Line] = [
            ("reward", REWARD_COLOUR, ()),
            *((n, c, ()) for n, c in zip(self._terms, colours, strict=True)),
        ]
        bound = "" if self._rho is None else f" (rho {self._rho:g}, dashed)"

        def add(title: str, lines: list[Line], legend: bool) -> Any:
            series = [uplot.Series(label=n, stroke=c, width=2, **({"dash": d} if d else {})) for n, c, d in lines]
            return gui.add_uplot(
                (self._seconds[-1:], *[np.zeros(1)] * len(series)),
                (uplot.Series(label="s"), *series),
                title=title,
                scales={"x": uplot.Scale(time=False, range=(-duration, 0.0))},
                legend=uplot.Legend(show=legend),
                height=HEIGHT + 50 * legend,
            )

        self.deviation = add(f"deviation{bound}", deviation, False)
        self.reward = add("reward and its terms", reward, True)

    def keep(self, frame: Frame) -> None:
        """Take in a control step."""
        terms = [frame.reward_terms.get(name, 0.0) for name in self._terms]
        self._history.append([frame.deviation, frame.reward, *terms])

    def show(self) -> None:
        """Bring the plots up to date."""
        deviation, *reward = np.array(self._history).T
        seconds = self._seconds[-len(deviation) :]
        bound = [] if self._rho is None else [np.full(len(deviation), self._rho)]
        self.deviation.data = (seconds, deviation, *bound)
        self.reward.data = (seconds, *reward)
