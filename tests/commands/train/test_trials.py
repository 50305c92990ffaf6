"""Trials of a search on rungs, with made-up scores."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from ogmp_sb3.commands.train.space import read_space
from ogmp_sb3.commands.train.trials import FILE, NAME, SearchConfig, Trials

optuna = pytest.importorskip("optuna", reason="needs the extra 'optuna'")
Score = Callable[[dict[str, Any], int], float | None]


class Killed(Exception):
    pass


def search(
    folder: Path, score: Score, *words: str, total: int = 900, steps: int = 10_000, **settings: Any
) -> tuple[Trials, list[tuple[str, int]]]:
    """A search, which is killed after so many batches.

    :return: the trials, and what was trained in which order
    """
    folder.mkdir(exist_ok=True)
    space = read_space(OverridesParser.create().parse_overrides(list(words or ("rho=interval(0,1)",))))
    trials, trained = Trials(folder, space, SearchConfig(**settings), total), []
    active: dict[str, Any] = {}
    for _ in range(steps):
        active = trials.filled(active)
        if not active:
            return trials, trained
        for name in list(active):
            trained.append((name, trials.budget(name)))
            found = score(trials.values[name], trials.budget(name))
            if found is None:
                trials.fail(name, active.pop(name))
            else:
                trials.report(name, active[name], found)
        active = {name: trial for name, trial in active.items() if not trials.settled(name, trial)}
    return trials, trained


def hill(values: dict[str, Any], budget: int) -> float:
    """Best at 0.7, and better with samples."""
    return -abs(values["rho"] - 0.7) + budget / 1e4


def study(folder: Path) -> Any:
    storage = optuna.storages.JournalStorage(optuna.storages.journal.JournalFileBackend(str(folder / FILE)))
    return optuna.load_study(study_name=NAME, storage=storage)


@pytest.mark.parametrize(("pruner", "most"), [("halving", 0.5), ("hyperband", 0.8), ("median", 0.8), (None, 1.0)])
def test_a_search_ends_with_the_best_of_its_trials_trained_to_the_end(pruner: Any, most: float, tmp_path: Path) -> None:
    trials, trained = search(tmp_path, hill, n_trials=20, pruner=pruner, reduction=3)
    assert len(trials.values) == 20
    whole = [name for name, scores in trials.scores.items() if len(scores) == len(trials.budgets)]
    best = max(trials.values, key=lambda name: hill(trials.values[name], 0))
    assert best in whole
    assert abs(trials.values[best]["rho"] - 0.7) < 0.05
    spent = sum(trials.budgets[len(scores) - 1] for scores in trials.scores.values())
    assert spent == sum(budget for _, budget in trained) - sum(
        trials.budgets[rung] for scores in trials.scores.values() for rung in range(len(scores) - 1)
    )
    assert 0.15 < spent / (20 * 900) <= most
    assert (spent == 20 * 900) == (pruner is None)
    assert study(tmp_path).best_value == pytest.approx(hill(trials.values[best], 900))


def test_no_trial_trains_to_a_rung_twice(tmp_path: Path) -> None:
    _, trained = search(tmp_path, hill, n_trials=30, n_jobs=3)
    assert len(set(trained)) == len(trained)


def test_a_trial_that_stopped_is_promoted_when_worse_ones_came_and_goes_on_from_its_rung(tmp_path: Path) -> None:
    trials, trained = search(tmp_path, lambda values, budget: -values["rho"], n_trials=9, sampler="random", reduction=3)
    order = list(trials.values)
    ranked = sorted(order, key=lambda name: trials.values[name]["rho"])
    assert {name for name, scores in trials.scores.items() if len(scores) > 1} == set(ranked[:3])
    states = [(trial.state.name, trial.user_attrs.get("goes_on")) for trial in study(tmp_path).get_trials()]
    promoted = [name for state, name in states if name]
    assert set(promoted) <= set(ranked[:3]) and promoted
    for name in promoted:
        rungs = [budget for other, budget in trained if other == name]
        assert rungs == trials.budgets[: len(rungs)]
    assert sum(state == "COMPLETE" for state, _ in states) == 1


@pytest.mark.parametrize("steps", range(1, 30, 7))
@pytest.mark.parametrize("n_jobs", [1, 2])
def test_a_search_that_was_killed_draws_and_trains_what_it_would_have(steps: int, n_jobs: int, tmp_path: Path) -> None:
    settings = {"n_trials": 14, "n_jobs": n_jobs, "reduction": 3}
    whole, trained = search(tmp_path / "whole", hill, **settings)
    _, first = search(tmp_path / "killed", hill, steps=steps, **settings)
    again, rest = search(tmp_path / "killed", hill, **settings)
    assert again.values == whole.values
    assert again.scores == whole.scores
    assert sorted(first + rest) == sorted(trained)


def test_a_search_may_go_on_with_more_trials(tmp_path: Path) -> None:
    few, _ = search(tmp_path, hill, n_trials=4)
    more, _ = search(tmp_path, hill, n_trials=8)
    assert list(more.values)[:4] == list(few.values)
    assert len(more.values) == 8


def test_the_sampler_learns_from_those_that_were_pruned_too(tmp_path: Path) -> None:
    """Of the last half of the trials most are near the best; by chance they are not."""
    near = {}
    for sampler in ("tpe", "random"):
        trials, _ = search(tmp_path / sampler, hill, n_trials=40, sampler=sampler)
        rho = [values["rho"] for values in list(trials.values.values())[20:]]
        near[sampler] = sum(abs(value - 0.7) < 0.15 for value in rho)
    assert near["tpe"] >= 14 > near["random"]


def test_of_values_that_can_be_counted_each_is_tried_once_and_then_the_search_ends(tmp_path: Path) -> None:
    words = ["rho=0.1,0.3,0.5", "horizon=range(7,9)"]
    trials, trained = search(tmp_path, lambda values, budget: float(values["rho"]), *words, n_trials=50)
    assert len(trials.values) == 6
    assert sum(budget == trials.budgets[0] for _, budget in trained) == 6


def test_an_interval_that_holds_one_value_of_six_digits_ends_the_search(tmp_path: Path) -> None:
    trials, _ = search(tmp_path, hill, "rho=interval(0.2,0.20000001)", n_trials=3)
    assert len(trials.values) == 1


def test_a_trial_whose_training_fails_is_out_and_begins_again_with_the_same_command(tmp_path: Path) -> None:
    fails = {"now": True}

    def score(values: dict[str, Any], budget: int) -> float | None:
        return None if fails["now"] and values["rho"] > 0.5 else values["rho"]

    trials, _ = search(tmp_path, score, n_trials=6, sampler="random")
    failed = [name for name, scores in trials.scores.items() if not scores]
    assert failed == [name for name, values in trials.values.items() if values["rho"] > 0.5] != []
    fails["now"] = False
    again, _ = search(tmp_path, score, n_trials=6, sampler="random")
    assert list(again.values) == list(trials.values)
    assert all(again.scores.values())


def test_a_trial_that_fails_on_a_higher_rung_is_not_promoted_again(tmp_path: Path) -> None:
    def score(values: dict[str, Any], budget: int) -> float | None:
        return None if values["rho"] > 0.5 and budget > 56 else values["rho"]

    trials, trained = search(tmp_path, score, n_trials=9, sampler="random")
    assert len(set(trained)) == len(trained)
    whole = [name for name, scores in trials.scores.items() if len(scores) == 3]
    assert whole and all(trials.values[name]["rho"] <= 0.5 for name in whole)


def test_a_search_goes_on_though_it_was_killed_while_a_trial_was_drawn(tmp_path: Path) -> None:
    words = ["rho=interval(0,1)", "horizon=int(interval(7,30))"]
    whole, _ = search(tmp_path / "whole", hill, *words, n_trials=4)
    search(tmp_path / "killed", hill, *words, n_trials=2)
    study(tmp_path / "killed").ask({"rho": optuna.distributions.FloatDistribution(0, 1)})  # without the other key
    study(tmp_path / "killed").enqueue_trial({"rho": 0.3})
    for _ in range(2):
        again, _ = search(tmp_path / "killed", hill, *words, n_trials=4)
        assert len(again.values) == 4
    assert list(again.values)[:2] == list(whole.values)[:2]


def test_threads_may_change_when_a_search_goes_on(tmp_path: Path) -> None:
    for threads in (1, 2):
        search(tmp_path, hill, "rho=interval(0,1)", f"torch_threads={threads}", n_trials=1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"total": 1600}, r"of another search: 'samples' is \[56, 225, 900\] there and \[100, 400, 1600\] here"),
        ({"words": ["rho=interval(0,2)"]}, "of another search: 'searched' is "),
        (
            {"words": ["rho=interval(0,1)", "task=dive"]},
            r"of another search: 'given' is \[\] there and \['task=dive'\]",
        ),
        ({"pruner": "median"}, "'pruner' is halving there and median here. Choose another directory: hydra.sweep.dir="),
    ],
)
def test_another_search_in_the_directory_is_told_in_a_sentence(
    change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    search(tmp_path, hill, n_trials=1)
    with pytest.raises(ValueError, match=message):
        search(tmp_path, hill, *change.pop("words", []), **{"n_trials": 1, **change})


@pytest.mark.parametrize("text", ["no json\n{}\n", '{"op_code": 0}\n{}\n'])
def test_a_damaged_study_is_told_in_a_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / FILE).write_text(text)
    with pytest.raises(ValueError, match=rf"{FILE}: not readable as a study of Optuna's"):
        search(tmp_path, hill)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"n_trials": 0}, "'n_trials' must be .*1.*, found 0"),
        ({"n_jobs": -1}, "'n_jobs' must be"),
        ({"rungs": 0}, "'rungs' must be"),
        ({"reduction": 1}, "'reduction' must be"),
        ({"episodes": 0}, "'episodes' must be"),
        ({"seed": -1}, "'seed' must be"),
    ],
)
def test_settings_out_of_range_are_told_in_a_sentence(setting: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SearchConfig(**setting)
