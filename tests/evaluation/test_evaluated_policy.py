"""A policy with its evaluations, which are kept and found again."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from helpers.learners import make_policy
from helpers.programs import program
from helpers.projects import edit, make_project
from ogmp_sb3.evaluation.endless import endless
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy, rank_key
from ogmp_sb3.evaluation.grid import read_grid
from ogmp_sb3.evaluation.statistics import Estimate, estimate
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy

SHORT = "evaluation.episode_steps=20"
MEASURED = Evaluation({"return": estimate([1.0, 2.0])}, {}, 0.5, {"fall": 2})


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_policy(tmp_path_factory.mktemp("evaluated") / "policy", "parkour", 1)


@pytest.fixture
def copy(policy: Path, tmp_path: Path) -> Path:
    return shutil.copytree(policy, tmp_path / "policy")


def subject(folder: Path, *overrides: str) -> EvaluatedPolicy:
    return EvaluatedPolicy(load_policy(folder), list(overrides), folder)


def fail(*arguments: Any, **named: Any) -> None:
    raise AssertionError("played again")


def test_what_was_measured_before_is_not_played_again(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = subject(copy, SHORT)
    grid = read_grid("jump.w:0.2:0.4:2,jump.h:0.2:0.3:1", first.task, first.loaded.task)
    assert (first.evaluation_steps(2, 0), first.grids_steps([grid], 1, 0)) == (2 * 20, 2 * 20)
    done: list[int] = []
    evaluation, cells = first.evaluation(2, 0, done.append), first.grids([grid], 1, 0, done.append)
    assert sum(done) == 2 * 20 + 2 * 20
    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.evaluate", fail)
    monkeypatch.setattr("ogmp_sb3.evaluation.grid.play_sets", lambda policy, tasks, *_, **__: iter(map(fail, tasks)))
    again = subject(copy, SHORT)
    assert (again.evaluation_steps(2, 0), again.grids_steps([grid], 1, 0)) == (0, 0)
    assert again.evaluation(2, 0, fail) == evaluation
    assert again.grids([grid], 1, 0, fail) == cells
    for episodes, seed in ((3, 0), (2, 1)):
        assert again.evaluation_steps(episodes, seed) == episodes * 20
        with pytest.raises(AssertionError, match="played again"):
            again.evaluation(episodes, seed, fail)


def test_cells_that_are_known_when_a_report_is_interrupted_are_kept(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ogmp_sb3.evaluation.episodes.BATCH", 2)
    first = subject(copy, "evaluation.episode_steps=5")
    grids = [
        read_grid(f"{mode}.w:0.2:0.4:2,{mode}.v:1.0:1.1:1", first.task, first.loaded.task) for mode in ("jump", "leap")
    ]
    done = 0

    def stopped(steps: int) -> None:
        nonlocal done
        done += steps
        if done > 3 * 2 * 5 + 4:  # in the fourth of four cells
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first.grids(grids, 2, 0, stopped)
    again = subject(copy, "evaluation.episode_steps=5")
    assert again.grids_steps(grids, 2, 0) == 2 * 5
    found = again.grids(grids, 2, 0, lambda n: None)
    assert again.grids_steps(grids, 2, 0) == 0
    assert [[cell["metrics"]["return"]["n"] for cell in grid["cells"]] for grid in found] == [[2, 2], [2, 2]]
    fresh = subject(copy, "evaluation.episode_steps=5", "evaluation.initial=null").grids(grids, 2, 0, lambda n: None)
    assert fresh != found


def test_what_ogmp_eval_left_is_used_for_the_same_settings_alone(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert program("eval", f"run={copy}", "episodes=3", SHORT, cwd=tmp_path).returncode == 0
    left = json.loads((copy / "evaluation" / "metrics.json").read_text())
    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.evaluate", lambda *arguments, **named: MEASURED)
    found = subject(copy, SHORT).evaluation(3, 0, lambda n: None)
    assert found.as_data() == {key: left[key] for key in found.as_data()}
    for overrides, episodes, seed in (([], 3, 0), ([SHORT], 2, 0), ([SHORT], 3, 1)):
        assert subject(copy, *overrides).evaluation(episodes, seed, lambda n: None) == MEASURED
    for change in ({"policy": "another"}, {"versions": {**left["versions"], "mujoco": "0"}}, {"groups": None}):
        (copy / "evaluation" / "metrics.json").write_text(json.dumps({**left, **change}))
        (copy / "evaluation" / "results.jsonl").unlink()
        assert subject(copy, SHORT).evaluation(3, 0, lambda n: None) == MEASURED


def test_endless_tests_are_kept_and_those_of_ogmp_eval_are_used(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["episodes=2", "protocol=endless", "max_distance=0.6"]  # 6 s at 0.1 m/s
    assert program("eval", f"run={copy}", *arguments, cwd=tmp_path).returncode == 0
    with monkeypatch.context() as patch:
        patch.setattr("ogmp_sb3.evaluation.evaluated_policy.play_episodes", fail)
        left = subject(copy).endless(2, 0, 0.6, lambda n: None)
        for episodes, distance in ((2, 0.7), (1, 0.6)):
            with pytest.raises(AssertionError, match="played again"):
                subject(copy).endless(episodes, 0, distance, lambda n: None)
    assert set(left.survival) == {"distance_m", "time_s"} and left.episodes == 2
    for file in ("results.jsonl", "metrics.json"):
        (copy / "evaluation" / file).unlink()
    assert subject(copy).endless(2, 0, 0.6, lambda n: None) == left  # measured
    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.play_episodes", fail)
    assert subject(copy).endless(2, 0, 0.6, fail) == left
    assert subject(copy).endless_steps(2, 0, 0.6) == 0
    assert subject(copy).endless_steps(3, 0, 0.6) == 3 * endless(subject(copy).task, 0.6).episode_steps


def test_evaluations_that_were_kept_without_the_numbers_of_each_episode_are_made_anew(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As results.jsonl of an earlier version holds them."""
    found = subject(copy, SHORT).evaluation(2, 0, lambda n: None)
    assert {len(numbers) for numbers in found.values.values()} == {2}
    file = copy / "evaluation" / "results.jsonl"
    line = json.loads(file.read_text())
    del line["settings"]["kept"], line["result"]["values"], line["result"]["falls"]
    file.write_text(json.dumps(line))
    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.evaluate", lambda *arguments, **named: MEASURED)
    assert subject(copy, SHORT).evaluation(2, 0, lambda n: None) == MEASURED


def test_what_is_to_select_is_measured_on_other_tracks_than_what_is_reported(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert program("eval", f"run={copy}", "episodes=3", SHORT, cwd=tmp_path).returncode == 0
    asked: list[Any] = []
    monkeypatch.setattr(
        "ogmp_sb3.evaluation.evaluated_policy.evaluate", lambda *arguments: asked.append(arguments[-1]) or MEASURED
    )
    tested = subject(copy, SHORT).evaluation(3, 0, lambda n: None)
    assert asked == [] and tested != MEASURED  # as ogmp-eval left it
    assert subject(copy, SHORT).evaluation(3, 0, lambda n: None, "selection") == MEASURED
    assert asked == ["selection"]
    assert subject(copy, SHORT).evaluation(3, 0, lambda n: None) == tested


def test_what_was_measured_on_the_tracks_of_an_earlier_version_is_measured_again(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert program("eval", f"run={copy}", "episodes=3", SHORT, cwd=tmp_path).returncode == 0
    file = copy / "evaluation" / "metrics.json"
    left = json.loads(file.read_text())
    del left["stream"]
    file.write_text(json.dumps(left))
    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.evaluate", lambda *arguments: MEASURED)
    assert subject(copy, SHORT).evaluation(3, 0, lambda n: None) == MEASURED


def test_results_lie_in_the_file_as_plain_data(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.evaluate", lambda *arguments, **named: MEASURED)
    subject(copy, SHORT).evaluation(3, 0, lambda n: None)
    (line,) = filter(None, (copy / "evaluation" / "results.jsonl").read_text().splitlines())
    assert json.loads(line)["result"]["metrics"]["return"] == estimate([1.0, 2.0]).as_data()


def test_traces_have_their_seeds_and_a_bound_that_is_asked_for_ends_them(copy: Path) -> None:
    traces = subject(copy, SHORT).traces(2, 5)
    assert [trace.title.split(",")[0] for trace in traces] == ["seed 5", "seed 6"]
    (bound,) = subject(copy, SHORT).traces(1, 5, "bound", ("rho=0.001",))
    assert (bound.ended, bound.rho) == ("bound", 0.001)


def test_policies_are_ranked_by_the_true_objective_then_the_return() -> None:
    metrics = {"return": Estimate(5.0, None, 1, None, None), "true_objective": Estimate(2.0, None, 1, None, None)}
    assert rank_key(Evaluation(metrics, {}, 0.0, {})) == [2.0, 5.0]


def test_another_robot_is_measured_anew_and_so_is_one_whose_included_file_changed(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_project(tmp_path / "project")
    measured: list[LoadedPolicy] = []

    def measure(loaded: LoadedPolicy, *arguments: Any) -> Evaluation:
        measured.append(loaded)
        return MEASURED

    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.evaluate", measure)

    def evaluation() -> None:
        loaded = load_policy(copy, robot=tmp_path / "project" / "robot.yaml")
        EvaluatedPolicy(loaded, [], copy).evaluation(2, 0, lambda n: None)

    subject(copy).evaluation(2, 0, lambda n: None)
    for change, times in (("<mujoco>", 2), ("<mujoco><!-- -->", 2), ('<mujoco><option impratio="2"/>', 3)):
        edit(tmp_path / "project" / "models" / "hector" / "parts" / "all.xml", "<mujoco>", change)
        for _ in range(2):
            evaluation()
        assert len(measured) == times
