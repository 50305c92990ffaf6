"""Evaluate a policy in one call, and what an evaluation says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ogmp_sb3
from helpers.learners import make_policy
from helpers.programs import program
from helpers.records import record
from ogmp_sb3.config import registry
from ogmp_sb3.config.answers import FunctionFailed
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.evaluate import Evaluation, estimates, estimates_by_word, evaluate, measure
from ogmp_sb3.runs.policies import load_policy

DIVE = load_task("dive")


class Standing:
    """A policy that holds the nominal pose."""

    def predict(self, observation: np.ndarray, *_: Any, **__: Any) -> tuple[np.ndarray, None]:
        return np.zeros((len(observation), 10)), None


def test_the_function_gives_what_the_program_prints_and_writes(tmp_path: Path) -> None:
    make_policy(tmp_path / "policy", "dive", 1)
    done = program("eval", "run=policy", "episodes=5", "out=out", "evaluation.episode_steps=15", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    task = load_task("dive", {"evaluation.episode_steps": 15})
    evaluation = ogmp_sb3.evaluate(load_policy(tmp_path / "policy"), task, episodes=5)
    printed = done.stdout.splitlines()
    assert printed[-1] == str(Path("out") / "metrics.json")
    assert str(evaluation).splitlines() == [line.rstrip() for line in printed[:-1]]
    written = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert evaluation.as_data() == {key: written[key] for key in evaluation.as_data()}
    assert Evaluation.from_data(written) == evaluation


def test_a_task_by_name_or_as_it_is_in_training_is_played_by_its_test_protocol() -> None:
    task = load_task("parkour", {"evaluation.episode_steps": 12, "evaluation.terminations.fall": None})
    assert (task.rho, task.episode_steps) != (None, 12)
    done: list[int] = []
    evaluation = evaluate(Standing(), task, episodes=2, seed=3, progress=done.append)  # type: ignore[arg-type]
    assert evaluation == evaluate(Standing(), task.for_evaluation(), episodes=2, seed=3)  # type: ignore[arg-type]
    assert (evaluation.terminations, sum(done)) == ({"time_limit": 2}, 2 * 12)
    assert evaluate(Standing(), "dive", episodes=1).title == "dive, 1 episodes, physics step 0.002 s"  # type: ignore[arg-type]


def test_mistakes_are_one_sentence() -> None:
    with pytest.raises(KeyError, match=r"parkuor.*Did you mean 'parkour'"):
        evaluate(Standing(), "parkuor")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="'episodes' must be at least 1, found 0"):
        evaluate(Standing(), "dive", episodes=0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"the task shows [0-9]+ numbers, but the policy observes [0-9]+"):
        evaluate(load_policy("parkour"), "dive", episodes=1)


def test_an_evaluation_counts_what_ended_the_episodes_and_has_the_median_distance() -> None:
    ends = [np.outer(np.ones(151), [x, 0.0, 0.0]) for x in (1.0, 2.0, 4.0)]
    for way in ends:
        way[0] = 0.0
    causes = ("fall", "time_limit", "fall")
    records = [record(base_pos_w=way, termination=cause) for way, cause in zip(ends, causes, strict=True)]
    evaluation = measure(DIVE.for_evaluation(), records)
    assert evaluation.terminations == {"fall": 2, "time_limit": 1}
    assert evaluation.median_distance_m == 2.0
    assert evaluation.metrics["true_objective"].mean == pytest.approx(1 / 3)
    assert "Ended by: fall 2, time_limit 1. Median distance 2.00 m." in str(evaluation)


def test_each_word_of_the_first_mode_has_its_metrics() -> None:
    records = [record("left"), record("front", 0.0), record("left", 0.0)]
    groups = estimates_by_word(DIVE, records)
    assert list(groups) == ["r=front", "r=left"]
    assert (groups["r=left"]["success_rate"].mean, groups["r=left"]["success_rate"].n) == (0.5, 2)


def test_evaluations_of_earlier_versions_are_read(tmp_path: Path) -> None:
    each = {"mean": 1.0, "std": None, "n": 1, "ci95": [None, None]}
    data = {"metrics": {"return": each}, "groups": {}, "median_distance_m": 0.0, "terminations": {"fall": 1}}
    since = {"episodes": 1, "copies": 0, "speeds": [], "falls": [], "values": {}}
    assert Evaluation.from_data({**data, "run": "x", "seed": 0}).as_data() == {**data, **since}


def test_an_evaluation_on_a_track_has_the_error_in_speed_and_a_table_by_mode_whatever_the_task_lists() -> None:
    task = load_task("parkour", {"evaluation.metrics": ["return"]}).for_evaluation()
    way = np.outer(np.arange(151) * 0.03, [0.8, 0.0, 0.0])  # 0.8 m/s
    pace = ({"mode": "pace", "v": 1.0, "length": 9.0},)
    evaluation = measure(task, [record(base_pos_w=way, modes=pace, track_length=10.0)])
    assert list(evaluation.metrics) == ["return", "speed_error_mps", "true_objective"]
    assert evaluation.metrics["speed_error_mps"].mean == pytest.approx(0.2)
    (row,) = evaluation.speeds
    assert (row.mode, row.commanded.mean, row.measured.mean) == ("pace", pytest.approx(1.0), pytest.approx(0.8))
    assert "speed along the track, m/s" in str(evaluation)
    assert "pace" in str(Evaluation.from_data(json.loads(json.dumps(evaluation.as_data()))))


def test_timed_modes_have_no_error_in_speed_and_listing_it_is_refused_before_an_episode_is_played() -> None:
    evaluation = measure(DIVE.for_evaluation(), [record()])
    assert evaluation.speeds == () and "speed" not in str(evaluation)
    with pytest.raises(
        ValueError, match=r"tasks/dive.yaml: 'evaluation.metrics' has 'speed_error_mps', which is for .* 'dive' take a"
    ):
        evaluate(Standing(), load_task("dive", {"evaluation.metrics": ["speed_error_mps"]}))  # type: ignore[arg-type]


def test_a_track_without_a_horizon_is_told_that_it_needs_one() -> None:
    with pytest.raises(ValueError, match="'horizon' must be a number of control steps for modes along a track"):
        evaluate(Standing(), load_task("parkour", {"horizon": None}))  # type: ignore[arg-type]


def test_the_interval_of_the_true_objective_does_not_go_beyond_what_it_can_reach() -> None:
    task = load_task("parkour").for_evaluation()
    records = [record(base_pos_w=np.outer(np.linspace(0.0, x, 151), [1.0, 0.0, 0.0]), track_length=10.0,
                      modes=({"mode": "pace", "v": 1.0, "length": 9.0},)) for x in (9.0, 11.0, 12.0, 10.5)]  # fmt: skip
    objective = estimates(task, records)["true_objective"]
    assert (objective.mean, objective.high) == (9.75, 10.0)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (None, "^what metric 'mine' returns must be a number, or true or false; it is nothing"),
        (1j, "^what metric 'mine' returns must be a number, or true or false; it is"),
        (np.zeros(3), r"^what metric 'mine' returns .* it is an array of shape \(3,\) of float64"),
    ],
)
def test_a_metric_that_gives_no_number_is_named(value: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    task = load_task("parkour")
    task = replace(task, evaluation=replace(task.evaluation, metrics=("mine",)))
    monkeypatch.setitem(registry.metrics._functions, "mine", lambda record: value)
    with pytest.raises(TypeError, match=message):
        measure(task, [record()])
    for wrong, text in ((float("nan"), "nan"), (np.float32("-inf"), "-inf")):
        monkeypatch.setitem(registry.metrics._functions, "mine", lambda record, wrong=wrong: wrong)
        with pytest.raises(ValueError, match=f"^what metric 'mine' returns must be finite; it is {text}.$"):
            measure(task, [record()])
    monkeypatch.setitem(registry.metrics._functions, "mine", lambda record: record.nonsense)
    with pytest.raises(FunctionFailed, match=r"^metric 'mine' failed in line \d+ .*: AttributeError: .* 'nonsense'\.$"):
        measure(task, [record()])


def test_an_evaluation_without_end_has_survival_curves_and_the_median_that_these_give() -> None:
    pace = ({"mode": "pace", "v": 1.0, "length": 90.0},)
    records = [
        record(base_pos_w=np.outer(np.linspace(0.0, end, 151), [1.0, 0.0, 0.0]), modes=pace, termination=cause)
        for end, cause in ((10.0, "fall"), (20.0, "max_distance"), (30.0, "fall"), (40.0, "max_distance"))
    ]
    evaluation = measure(load_task("parkour").for_evaluation(), records)
    assert evaluation.survival["distance_m"].median == 30.0  # the median of the distances is 25
    text = " ".join(str(evaluation).split())
    assert "Median distance to a fall: 30.0 m (95 % interval over episodes: 10.0 .. open); time: 4.5 s (" in text
    assert Evaluation.from_data(json.loads(json.dumps(evaluation.as_data()))) == evaluation


def test_an_evaluation_keeps_the_numbers_of_each_episode_copies_left_out() -> None:
    records = [record("left"), record("front", 0.0), record("left")]
    evaluation = measure(DIVE.for_evaluation(), records)
    assert evaluation.values["success_rate"] == [True, False]
    assert set(evaluation.values) == set(evaluation.metrics)
    for name, numbers in evaluation.values.items():
        assert evaluation.metrics[name].mean == pytest.approx(np.mean(numbers))
        assert all(type(number) in (bool, float) for number in numbers)
