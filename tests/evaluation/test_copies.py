"""Episodes that are copies of others count once, wherever episodes are counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from helpers.records import STEPS, record
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.evaluation import epsilon, grid, robustness
from ogmp_sb3.evaluation.copies import copies_in_sets_text, copies_text, distinct, first_of_each
from ogmp_sb3.evaluation.episodes import play_episodes
from ogmp_sb3.evaluation.evaluate import Evaluation, measure
from ogmp_sb3.guidance.sampling import ModeCall

FIXED = {"modes.flip": {"r": "front", "h": 1.2}, "evaluation.episode_steps": 20, "evaluation.initial": None}


class Standing:
    """A policy that holds the nominal pose."""

    def predict(self, observation: np.ndarray, state: Any = None, *_: Any, **__: Any) -> tuple[np.ndarray, Any]:
        return np.zeros((len(observation), 10)), state


def test_episodes_that_differ_in_one_bit_of_anything_are_no_copies() -> None:
    little = np.zeros((STEPS + 1, 3))
    little[70, 1] = 1e-300
    ends = record(termination="fall")
    other_track = record(modes=({"mode": "flip", "r": "front", "h": 1.1}, {"mode": "settle"}))
    records = [record(), record(base_pos_w=little), record(), ends, other_track, record(base_pos_w=little.copy())]
    assert first_of_each(records) == [0, 1, 3, 4]
    assert [id(each) for each in distinct(records)] == [id(records[i]) for i in (0, 1, 3, 4)]


def test_episodes_that_differ_in_one_bit_of_what_the_oracle_answered_are_no_copies() -> None:
    call = ModeCall("flip", {"h": 1.2})
    plans = [np.zeros((200, 12)) for _ in range(3)]
    plans[1][100, 6] = 1e-300
    queries = [((plan, call),) for plan in plans]
    records = [record(queries=each) for each in (*queries, ((plans[0], ModeCall("flip", {"h": 1.1})),))]
    assert first_of_each(records) == [0, 1, 3]


def test_a_task_without_chance_has_one_episode_however_many_are_played(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ogmp_sb3.evaluation.episodes.BATCH", 3)
    task = load_task("dive", FIXED).for_evaluation()
    assert len(distinct(play_episodes(Standing(), task, 7, 0))) == 1  # type: ignore[arg-type]
    chance = replace(task, modes={**task.modes, "flip": {**task.mode_ranges["flip"], "h": Range(1.0, 1.5)}})
    assert len(distinct(play_episodes(Standing(), chance, 7, 0))) == 7  # type: ignore[arg-type]


def test_an_evaluation_counts_copies_once_and_says_so() -> None:
    task = load_task("dive").for_evaluation()
    played = [record(), record(), record("left", 0.0), record(), record("left", 0.0)]
    evaluation = measure(task, played)
    assert evaluation.metrics["success_rate"].n == 2
    assert {name: metrics["return"].n for name, metrics in evaluation.groups.items()} == {"r=front": 1, "r=left": 1}
    assert (evaluation.terminations, evaluation.copies, evaluation.episodes) == ({"time_limit": 2}, 3, 5)
    assert "dive, 5 episodes" in str(evaluation)
    assert "3 of 5 episodes are copies of others and count once." in str(evaluation)
    assert (evaluation.as_data()["episodes"], evaluation.as_data()["copies"]) == (5, 3)
    assert Evaluation.from_data(evaluation.as_data()) == evaluation
    assert "copies" not in str(measure(task, played[1:3]))


def test_so_do_cells_of_a_grid_sizes_of_a_disturbance_and_epsilon() -> None:
    policy: Any = Standing()
    task = load_task("dive", {**FIXED, "evaluation.terminations.fall": None}).for_evaluation()
    (cell,) = grid.evaluate_cells(policy, task, [("flip", {"h": Range(1.2, 1.2)})], 3, 0)
    assert {each.n for each in cell.values()} == {1}
    mass = next(each for each in robustness.task_disturbances(task) if each.name == "mass")
    (result,) = robustness.play_disturbed([mass], policy, task, 2, 0, None, lambda _: None)
    assert {point["no_fall_fraction"]["n"] for point in result["points"]} == {1}
    report = {"robustness": [result], "episodes": 2}
    sizes = len(mass.points)
    assert robustness.robustness_copies_text(report).startswith(f"In {sizes} of {sizes} sizes of disturbances, ")
    found = epsilon.estimate_epsilon(policy, task, 4, 0, lambda _: None)
    assert (found["episodes"], found["left_out"], found["copies"]) == (1, 0, 3)


def test_sentences_on_copies() -> None:
    assert copies_text(0, 9) == ""
    assert copies_text(1, 2) == "1 of 2 episodes is a copy of another and counts once."
    assert copies_in_sets_text([5, 5], 5, "cells") == ""
    assert copies_in_sets_text([1, 5, 3], 5, "cells") == (
        "In 2 of 3 cells, episodes are copies of others and count once: 1 to 3 of 5 are left."
    )
    assert copies_in_sets_text([1, 1], 5, "jobs").endswith("count once: 1 of 5 are left.")
