"""Terms that answer wrongly are found at their first answer, and named."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from helpers.views import make_view
from ogmp_sb3.config.answers import FunctionFailed
from ogmp_sb3.config.registry import Registry
from ogmp_sb3.env.observations import Part, Signal
from ogmp_sb3.env.terms import Term, bind

ROWS = 3


def term(kind: str, answer: Any) -> Term:
    """A term of the name ``mine`` that always gives the same answer."""
    return Term(kind, "mine", lambda view: answer)


REWARDS = {
    "nothing": (None, TypeError, r"a number for each environment, .* shape \(3,\); it is nothing"),
    "scalar": (1.5, TypeError, r"it is the number 1\.5\."),
    "list": ([1.0, 2.0, 3.0], TypeError, r"it is the list \[1\.0, 2\.0, 3\.0\]"),
    "text": (np.array(["a", "b", "c"]), TypeError, r"it is an array of shape \(3,\) of <U1"),
    "column": (np.zeros((3, 1)), ValueError, r"it is an array of shape \(3, 1\) of float64"),
    "one for all": (np.zeros(1), ValueError, r"it is an array of shape \(1,\) of float64"),
    "0-d": (np.float64(2.0), TypeError, r"it is the value np\.float64\(2\.0\)"),
    "NaN": (np.array([0.0, np.nan, 0.0]), ValueError, r"finite; it holds nan"),
    "infinite": (np.array([0.0, 0.0, -np.inf]), ValueError, r"finite; it holds -inf"),
}


@pytest.mark.parametrize("case", REWARDS)
def test_a_reward_is_a_finite_number_for_each_environment(case: str) -> None:
    answer, kind, message = REWARDS[case]
    with pytest.raises(kind, match=f"^what reward 'mine' returns must be .*{message}"):
        term("reward", answer)(make_view(ROWS))


@pytest.mark.parametrize(
    "answer", [np.zeros(ROWS), np.zeros(ROWS, np.float32), np.zeros(ROWS, int), np.ones(ROWS, bool)]
)
def test_any_numbers_will_do_as_rewards(answer: np.ndarray) -> None:
    assert term("reward", answer)(make_view(ROWS)) is answer


@pytest.mark.parametrize("answer", [np.zeros(ROWS), np.zeros(ROWS, int), True, np.zeros((ROWS, 1), bool), None])
def test_a_termination_is_true_or_false_for_each_environment(answer: Any) -> None:
    message = r"what termination 'mine' returns must be true or false for each environment, .* shape \(3,\) of bool; it"
    with pytest.raises((TypeError, ValueError), match=message):
        term("termination", answer)(make_view(ROWS))
    ends = np.array([True, False, True])
    assert term("termination", ends)(make_view(ROWS)) is ends


OBSERVATIONS = {
    "no signal": (np.zeros((3, 2)), "what observation 'mine' returns must be a Signal, .* it is an array of shape"),
    "flat value": (Signal(np.zeros(3), np.ones(3)), r"the value .* an array of \(3, size\); it is .* shape \(3,\)"),
    "other rows": (Signal(np.zeros((2, 4)), np.ones(4)), r"the value of the Signal of observation 'mine' .*\(2, 4\)"),
    "list": (Signal([[0.0]] * 3, np.ones(1)), "the value .* it is the list"),
    "NaN": (Signal(np.full((3, 2), np.nan), np.ones(2)), "the value .* must be finite; it holds nan"),
    "short scale": (Signal(np.zeros((3, 2)), np.ones(1)), r"the scale .* shape \(2,\); it is .* shape \(1,\)"),
    "scalar scale": (Signal(np.zeros((3, 2)), 0.5), r"the scale .* shape \(2,\); it is the number 0\.5"),
    "long part": (
        Signal(np.zeros((3, 2)), np.ones(2), (Part("p", "m", 3),)),
        "the parts .* 2 values in all; found 3",
    ),
    "scale of zero": (Signal(np.zeros((3, 2)), np.array([1.0, 0.0])), "the scale .* above 0; it holds 0"),
}


@pytest.mark.parametrize("case", OBSERVATIONS)
def test_an_observation_is_a_signal_of_fitting_shapes(case: str) -> None:
    answer, message = OBSERVATIONS[case]
    with pytest.raises((TypeError, ValueError), match=message):
        term("observation", answer)(make_view(ROWS))


def test_where_the_simulation_is_not_finite_terms_need_not_be() -> None:
    view = make_view(ROWS)
    view.state[1] = np.nan
    spoilt = np.array([0.0, np.nan, 0.0])
    np.testing.assert_array_equal(term("reward", spoilt)(view), spoilt)
    term("observation", Signal(spoilt[:, None], np.ones(1)))(view)
    view.joint_vel[2] = np.inf
    term("reward", np.array([0.0, np.nan, np.nan]))(view)
    with pytest.raises(ValueError, match="must be finite; it holds nan"):
        term("reward", np.array([np.nan, 0.0, 0.0]))(view)


def test_only_the_first_answer_about_an_environment_is_looked_at() -> None:
    answers = iter([np.zeros(0), np.zeros(ROWS), np.full(ROWS, np.nan)])
    later = Term("reward", "mine", lambda view: next(answers))
    assert later(make_view(0)).shape == (0,)
    later(make_view(ROWS))
    assert np.isnan(later(make_view(ROWS))).all()


def test_a_wrong_answer_stays_wrong() -> None:
    wrong = term("reward", 1.0)
    for _ in range(2):
        with pytest.raises(TypeError, match="reward 'mine'"):
            wrong(make_view(ROWS))


def test_terms_in_use_are_bound_to_their_parameters() -> None:
    kinds: Registry[Callable[..., Any]] = Registry("reward", arguments=1)

    @kinds.register()
    def twice(view: Any, weight: float) -> np.ndarray:
        return np.full(len(view.state), 2.0 * weight)

    terms = bind(kinds, {"twice": {"weight": 3.0}, "unused": None})
    assert list(terms) == ["twice"]
    np.testing.assert_array_equal(terms["twice"](make_view(ROWS)), [6.0, 6.0, 6.0])


def test_an_exception_of_a_term_is_a_sentence_that_names_the_term_and_its_line() -> None:
    def fails(view: Any) -> np.ndarray:
        return np.zeros(3)[7]  # type: ignore[no-any-return]

    line = fails.__code__.co_firstlineno + 1
    message = rf"^reward 'mine' failed in line {line} of env/test_terms.py: IndexError: index 7 is out of .*\.$"
    with pytest.raises(FunctionFailed, match=message) as caught:
        Term("reward", "mine", fails)(make_view(ROWS))
    assert isinstance(caught.value.__cause__, IndexError)


def test_a_term_that_cannot_be_called_is_named_too() -> None:
    with pytest.raises(FunctionFailed, match=r"^reward 'mine' failed: TypeError: .* takes 0 positional arguments"):
        Term("reward", "mine", lambda: np.zeros(ROWS))(make_view(ROWS))  # type: ignore[arg-type, misc]


def test_a_sentence_that_names_the_term_stays_as_it_is() -> None:
    def refuses(view: Any) -> np.ndarray:
        raise ValueError("reward 'mine' needs a robot with a tail.")

    with pytest.raises(ValueError, match=r"^reward 'mine' needs a robot with a tail\.$"):
        Term("reward", "mine", refuses)(make_view(ROWS))
