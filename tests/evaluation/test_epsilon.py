"""How far states stray from the references of every oracle."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from helpers.learners import make_policy
from helpers.programs import program
from helpers.records import record
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.evaluation.episodes import play_batch
from ogmp_sb3.evaluation.epsilon import ShadowedEnv, epsilon_rows, epsilon_tables, estimate_epsilon
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.report.plots.evaluations import plot_epsilon

OPEN = {"curriculum": None, "terminations": {"fall": None}, "rho": None, "min_step_reward": None, "episode_steps": 40}


class Waver:
    """A policy that moves its joints up and down."""

    def __init__(self, task: TaskConfig) -> None:
        self.joints, self.calls = len(task.robot_config.joints), 0

    def predict(self, observation: np.ndarray, state: Any, episode_start: np.ndarray, deterministic: bool) -> Any:
        self.calls += 1
        return np.full((len(observation), self.joints), 0.1 * np.sin(self.calls)), state


@pytest.mark.parametrize("oracle", ["linear", "lqr", "preview"])
def test_the_shadow_of_the_own_oracle_is_the_own_deviation(oracle: str) -> None:
    task = load_task("parkour", {**OPEN, "oracle": oracle})
    plain, shadowed = BatchEnv(task, 3, 5, stream="test"), ShadowedEnv(task, 3, 5)
    assert np.array_equal(plain.reset(), shadowed.reset())
    expected: list[float] = []
    for k in range(40):  # beyond a query
        action = np.full((3, plain.action_size), 0.1 * np.sin(k))
        first, second = plain.step(action), shadowed.step(action)
        assert np.array_equal(first.observation, second.observation)
        expected += first.view.deviation.tolist()
    collected = {
        name: [x for row in shadowed.deviations for values in row[name].values() for x in values]
        for name in task.oracle_params
    }
    assert sorted(collected.pop(oracle)) == sorted(expected)
    assert all(sum(others) != pytest.approx(sum(expected)) for others in collected.values())


def test_the_spread_counts_every_step_of_whole_episodes_once_for_each_oracle_and_mode(monkeypatch) -> None:
    def second_falls(*arguments: Any) -> list[EpisodeRecord]:
        records = play_batch(*arguments)
        return [replace(record, termination="fall") if i == 1 else record for i, record in enumerate(records)]

    monkeypatch.setattr("ogmp_sb3.evaluation.epsilon.play_batch", second_falls)
    task = load_task("parkour", OPEN)
    done: list[int] = []
    found = estimate_epsilon(Waver(task), task, 4, 0, done.append)  # type: ignore[arg-type]
    assert sum(done) == 4 * 40
    assert (found["episodes"], found["left_out"]) == (3, 1)
    assert found["unit"] == "norm of W (x - x_ref), W: x 1"
    assert set(found["oracles"]) == {"linear", "lqr", "preview"}
    for modes in found["oracles"].values():
        assert sum(spread["steps"] for spread in modes.values()) == 3 * 40
        for spread in modes.values():
            assert 0.0 <= spread["median"] <= spread["p95"] <= spread["max"]


def test_a_bound_holds_an_episode_if_it_holds_every_step_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of these steps 95 % are within 0.1, of the episodes none, within 0.3 a half."""
    calm = [0.05] * 39
    played = [
        {"pace": [*calm, 0.2], "jump": calm},
        {"pace": [*calm, 0.3], "jump": calm},
        {"pace": calm, "jump": [*calm, 0.9]},
        {"pace": [*calm, 0.4]},
    ]

    env = SimpleNamespace(deviations=[{"lqr": modes, "preview": modes} for modes in played])
    records = [record(height=np.full(len(calm), i), phase=np.full(len(calm), i)) for i in range(4)]
    monkeypatch.setattr("ogmp_sb3.evaluation.epsilon.ShadowedEnv", lambda *_: env)
    monkeypatch.setattr("ogmp_sb3.evaluation.epsilon.play_batch", lambda *_: records)
    task = replace(load_task("parkour", OPEN), oracle_params={"lqr": {}, "preview": {}})
    found = estimate_epsilon(Waver(task), task, 4, 0, lambda _: None, bounds=(0.1, 0.2, 0.3, 0.5, 0.9))  # type: ignore[arg-type]
    maxima = found["maxima"]["lqr"]
    assert [share["mean"] for share in maxima["all"]["within"]] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert {share["n"] for share in maxima["all"]["within"]} == {maxima["all"]["n"]} == {4}
    assert [share["ci95"] for share in maxima["all"]["within"]][2] == pytest.approx([0.150, 0.850], abs=1e-3)  # Wilson
    assert (maxima["all"]["median"], maxima["all"]["max"]) == (pytest.approx(0.35), 0.9)
    assert (maxima["jump"]["n"], maxima["jump"]["max"], maxima["pace"]["max"]) == (3, 0.9, 0.4)
    steps = [value for modes in played for values in modes.values() for value in values]
    assert np.percentile(steps, 95) < 0.1
    assert found["oracles"]["lqr"]["pace"]["steps"] == 4 * 39 + 3
    report = {"epsilon": {"trained_with": {"oracle": "lqr", "rho": None}, **found}}
    assert epsilon_rows(report)[2] == {
        "oracle": "lqr", "mode": "all", "rho": 0.3, "episodes": 4, "within": 0.5,
        "ci95_low": pytest.approx(0.150, abs=1e-3), "ci95_high": pytest.approx(0.850, abs=1e-3),
    }  # fmt: skip


def test_a_policy_that_always_falls_has_no_epsilon(tmp_path: Path) -> None:
    task = load_task("parkour", {**OPEN, "terminations": {"fall": {"min_height": 5.0}}})
    found = estimate_epsilon(Waver(task), task, 2, 0, lambda _: None)  # type: ignore[arg-type]
    assert (found["episodes"], found["left_out"], found["oracles"], found["maxima"]) == (0, 2, {}, {})
    report = {"trained_with": {"oracle": "lqr", "rho": 0.3}, **found}
    console = Console(record=True, width=100)
    console.print(epsilon_tables(report))
    assert "0 episodes; 2 others ended before their time" in console.export_text()
    plot_epsilon(report, tmp_path / "epsilon.png")
    assert (tmp_path / "epsilon.png").is_file()


def test_in_a_timed_task_modes_are_told_apart_too() -> None:
    task = load_task("dive", {**OPEN, "terminations": {"fall": None}, "episode_steps": 120})
    found = estimate_epsilon(Waver(task), task, 2, 0, lambda _: None)  # type: ignore[arg-type]
    assert set(found["oracles"]["preview"]) == {"flip", "settle"}


def test_eval_says_that_it_is_an_estimate_and_what_biases_it(tmp_path: Path) -> None:
    make_policy(tmp_path / "policy", "dive", 1)
    arguments = ["epsilon=true", "episodes=1", "evaluation.episode_steps=5", "evaluation.terminations.fall=null"]
    done = program("eval", "run=policy", "out=out", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "an estimate biased by the training with preview, rho 0.3" in done.stdout
    assert "1 episodes; 0 others ended before their time" in " ".join(done.stdout.split())
    found = json.loads((tmp_path / "out" / "epsilon.json").read_text())["epsilon"]
    assert found["what"] == "an estimate, biased by the oracle and the rho of the training"
    assert found["trained_with"] == {"oracle": "preview", "rho": 0.3}
    assert found["unit"].endswith("W: z 1, wx 0.025, wy 0.025")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "epsilon.csv", "epsilon.json", "epsilon.png",
    ]  # fmt: skip
    (first, *others) = (tmp_path / "out" / "epsilon.csv").read_text().splitlines()
    assert first == "oracle,mode,rho,episodes,within,ci95_low,ci95_high"
    assert len(others) == 3 * 2 * 10  # oracles, flip and all modes, bounds
