"""The terms of a task: registered functions with their parameters, whose first answer is checked.

A term that answers wrongly would otherwise spoil a training unseen, or end it far from the mistake.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ogmp_sb3.config.answers import answer_text, call, check_array, check_finite
from ogmp_sb3.config.registry import Registry
from ogmp_sb3.config.task import Terms
from ogmp_sb3.env.observations import Signal
from ogmp_sb3.env.view import EnvView


class Term:
    """A term of a task, called with a view.

    :param kind: ``"observation"``, ``"reward"`` or ``"termination"``
    :param name: its name in the task file
    :param function: its function with the parameters bound
    """

    def __init__(self, kind: str, name: str, function: Callable[[EnvView], Any]) -> None:
        self._title, self._function = f"{kind} '{name}'", function
        self._check = CHECKS[kind]
        self._checked = False

    def __call__(self, view: EnvView) -> Any:
        """What the function answers.

        :raises FunctionFailed: if the function raises an exception
        :raises TypeError: if its first answer is of the wrong type
        :raises ValueError: if that has the wrong shape, or is not finite although the simulation is
        """
        answer = call(self._title, self._function, view)
        if not self._checked and len(view.state):
            self._check(self._title, answer, view)
            self._checked = True
        return answer


def bind(kinds: Registry[Any], terms: Terms) -> dict[str, Term]:
    """Terms in use with their parameters bound.

    :param kinds: observations, rewards or terminations
    :param terms: parameters by name; None: not in use
    """
    return {
        name: Term(kinds.kind, name, partial(kinds.get(name), **given))
        for name, given in terms.items()
        if given is not None
    }


def _check_reward(title: str, answer: Any, view: EnvView) -> None:
    what, rows = f"what {title} returns", len(view.state)
    check_array(what, answer, "biuf", (rows,), f"a number for each environment, an array of shape ({rows},)")
    _check_finite(what, answer, view)


def _check_termination(title: str, answer: Any, view: EnvView) -> None:
    rows = len(view.state)
    expected = f"true or false for each environment, an array of shape ({rows},) of bool"
    check_array(f"what {title} returns", answer, "b", (rows,), expected)


def _check_observation(title: str, answer: Any, view: EnvView) -> None:
    if not isinstance(answer, Signal):
        raise TypeError(
            f"what {title} returns must be a Signal, values and their typical sizes; it is {answer_text(answer)}."
        )
    rows, size = len(view.state), np.shape(answer.value)[-1] if np.ndim(answer.value) else 0
    what = f"the value of the Signal of {title}"
    check_array(what, answer.value, "biuf", (rows, size), f"numbers for each environment, an array of ({rows}, size)")
    _check_finite(what, answer.value, view)
    what = f"the scale of the Signal of {title}"
    check_array(
        what, answer.scale, "iuf", (size,), f"a typical size of each of its values, an array of shape ({size},)"
    )
    wrong = answer.scale[~(np.isfinite(answer.scale) & (answer.scale > 0))]
    if wrong.size:
        raise ValueError(f"{what} must be finite and above 0; it holds {wrong[0]:g}.")
    in_parts = sum(part.size for part in answer.parts)
    if answer.parts and in_parts != size:
        raise ValueError(f"the parts of the Signal of {title} must have {size} values in all; found {in_parts}.")


CHECKS: dict[str, Callable[[str, Any, EnvView], None]] = {
    "observation": _check_observation,
    "reward": _check_reward,
    "termination": _check_termination,
}


def _check_finite(what: str, answer: np.ndarray, view: EnvView) -> None:
    """Only where the simulation is: one that has failed shows in every term."""
    sound = np.ones(len(view.state), dtype=bool)
    for values in (view.state, view.joint_pos, view.joint_vel, view.torque):
        sound &= np.isfinite(values).all(axis=1)
    check_finite(what, answer, sound)
